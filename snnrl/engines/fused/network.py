"""`Network.step` for one trial at a time, compiled and event-driven.

Most synapses see no spike in most milliseconds, so eligibility and weight are brought up to date only
when they are needed. Within a block of milliseconds, with lambda = exp(-1 / tau_eligibility):

- A synapse stores `scaled` = eligibility / lambda^k at the k-th ms of the block, which only spikes change.
- The trial keeps `drive`, the sum of lambda^k times dopamine since the last flush. A weight that was
  settled when the sum was `settled` is now weight + scaled * (drive - settled), clipped.
- The clip is that of every ms, because weights move one way as long as neither eligibility changes
  (then the synapse is settled first) nor dopamine its sign (then all synapses are: a flush).
- A homeostatic set needs its mean only when an upper bound of it passes the limit: its sum at the last
  flush, plus |drive| times the sum of |scaled| of the synapses that can rise.

The results are those of `Network.step` to rounding; all tensors are up to date after every block.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from snnrl.engines.fused.philox import UNIT, fill_bits

LANES = 16  # neurons a block of the packed state
ROWS = 7  # v, u, a, b, c, d, fired
BLOCK = 100  # most ms between two points at which all tensors are up to date
SLACK = 1e-5  # of a homeostatic limit, for the rounding of the bound

# columns of NetworkArrays.groups
SIZE, START, STREAM, NOISY = range(4)
# columns of NetworkArrays.projections
PRE, POST, DELAY, SET, FIRST_ROW, FIRST_COLUMN = range(6)
# places in NetworkArrays.constants, which holds them in the network's precision
SQUARE, LINEAR, CONSTANT, HALF, PEAK, DECAY, BASELINE, RELEASE, WEIGHT_MAX, SYNAPTIC_GAIN = range(10)


class NetworkArrays(NamedTuple):
    """A network as arrays that share memory with its tensors; real ones are of its precision."""

    v: Any
    u: Any
    a: Any
    b: Any
    c: Any
    d: Any
    last_spike: Any
    pending: Any
    spike_count: Any
    level: Any
    total: Any  # float64 [B]
    released: Any
    weight: Any
    eligibility: Any
    settled: Any  # [S_plastic], work space
    source: Any  # int32 [S], presynaptic neuron within the trial
    target: Any  # int32 [S], postsynaptic neuron within the trial
    rows: Any  # offsets of each presynaptic neuron's synapses, by projection, trial and neuron
    columns: Any  # offsets into `incoming` of each postsynaptic neuron's plastic synapses, likewise
    incoming: Any  # int32, synapses ordered by postsynaptic neuron
    groups: Any  # int64 [G, 4]
    background: Any  # real [G, 2], constant and noise
    projections: Any  # int64 [P, 6], plastic ones first
    plastic: Any  # number of plastic projections
    set_limit: Any  # float64 [B, K]
    set_step: Any  # real [K]
    gain: Any  # real, potentiation by ms since the presynaptic spike
    loss: Any  # real, depression by ms since the postsynaptic spike
    fading: Any  # real [BLOCK + 1], lambda^k
    depresses: Any  # whether a pair of one ms does; else it potentiates
    modulated: Any  # whether there is dopamine
    source_group: Any  # place of the dopaminergic group, -1 for none
    threshold: Any
    constants: Any  # real [10], of the membrane's equation, dopamine and synapses
    trials: Any  # int64 [B], their numbers
    seed: Any  # uint64


class Work(NamedTuple):
    """Scratch of one thread."""

    state: Any
    current: Any
    noise: Any
    spikes: Any
    earlier: Any  # int64 [N], last spikes before this ms; kept only where a pair of one ms depresses
    first: Any  # [G + 1], where each group's spikes begin in `spikes`
    total: Any  # [K], weight of each set at the last flush
    rise: Any  # [K], how fast it can rise at most


@njit(forceinline=True)
def make_work(net):
    neurons, groups, sets = net.v.shape[1], net.groups.shape[0], net.set_step.shape[0]
    padded = (neurons + LANES - 1) // LANES * LANES
    noisy = 0
    for g in range(groups):
        if net.groups[g, NOISY]:
            noisy += padded_width(net.groups[g, SIZE])
    state = np.zeros(padded * ROWS, net.v.dtype)
    for i in range(neurons, padded):
        state[i // LANES * LANES * ROWS + i % LANES] = -65.0  # no neuron; rests and never fires
    return Work(
        state,
        np.zeros(padded, net.v.dtype),
        np.zeros((BLOCK + 6) * noisy, np.int32),
        np.zeros(padded, np.int64),
        np.zeros(padded, np.int64),
        np.zeros(groups + 1, np.int64),
        np.zeros(sets, np.float64),
        np.zeros(sets, np.float64),
    )


@njit(inline="always")
def padded_width(size):
    """Draws a row, rounded up so that no loop over them has a remainder."""
    return (size + LANES - 1) // LANES * LANES


@njit(forceinline=True)
def load(net, work, trial):
    """Pack the neurons of a trial in blocks of LANES, so that the update needs one base address."""
    for i in range(net.v.shape[1]):
        at = i // LANES * LANES * ROWS + i % LANES
        work.state[at] = net.v[trial, i]
        work.state[at + LANES] = net.u[trial, i]
        work.state[at + 2 * LANES] = net.a[trial, i]
        work.state[at + 3 * LANES] = net.b[trial, i]
        work.state[at + 4 * LANES] = net.c[trial, i]
        work.state[at + 5 * LANES] = net.d[trial, i]
    if net.depresses:
        work.earlier[: net.v.shape[1]] = net.last_spike[trial]


@njit(forceinline=True)
def store(net, work, trial):
    for i in range(net.v.shape[1]):
        at = i // LANES * LANES * ROWS + i % LANES
        net.v[trial, i] = work.state[at]
        net.u[trial, i] = work.state[at + LANES]


@njit(forceinline=True)
def update_neurons(state, current, constants, spikes):
    """One ms of all neurons; the fired ones' numbers go to `spikes`, their count is returned."""
    square, linear, constant = constants[SQUARE], constants[LINEAR], constants[CONSTANT]
    half, peak = constants[HALF], constants[PEAK]
    found = 0
    for block in range(len(current) // LANES):
        at, base = block * LANES * ROWS, block * LANES
        fired = 0
        for j in range(LANES):
            v, u, inflow = state[at + j], state[at + LANES + j], current[base + j]
            v = v + half * (square * v * v + linear * v + constant - u + inflow)
            v = v + half * (square * v * v + linear * v + constant - u + inflow)
            u = u + state[at + 2 * LANES + j] * (state[at + 3 * LANES + j] * v - u)
            spiked = v >= peak
            state[at + j] = state[at + 4 * LANES + j] if spiked else v
            state[at + LANES + j] = u + state[at + 5 * LANES + j] if spiked else u
            state[at + 6 * LANES + j] = 1.0 if spiked else 0.0
            fired += 1 if spiked else 0
        if fired:
            for j in range(LANES):
                if state[at + 6 * LANES + j] != 0.0:
                    spikes[found] = base + j
                    found += 1
    return found


@njit(forceinline=True)
def synapses_of(net, p, trial):
    """Where the synapses of projection p of a trial begin and end."""
    first = net.projections[p, FIRST_ROW]
    size = net.groups[net.projections[p, PRE], SIZE]
    return net.rows[first + trial * size], net.rows[first + (trial + 1) * size]


@njit
def _settle(weight, scaled, settled, drive, limit):
    """weight + scaled * (drive - settled), clipped; the drive starts at zero again."""
    zero = limit - limit
    for s in range(len(weight)):
        value = weight[s] + scaled[s] * (drive - settled[s])
        value = limit if value > limit else value
        weight[s] = zero if value < zero else value
        settled[s] = zero


@njit(forceinline=True)
def settle_all(net, trial, drive):
    """Bring every plastic weight of the trial up to date."""
    for p in range(net.plastic):
        low, high = synapses_of(net, p, trial)
        weight, scaled, settled = net.weight[low:high], net.eligibility[low:high], net.settled[low:high]
        _settle(weight, scaled, settled, drive, net.constants[WEIGHT_MAX])


@njit(fastmath={"reassoc", "nsz"})
def _sums(weight, scaled, limit, sign):
    """Sum of the weights, and of |scaled| where the weight can rise under dopamine of that sign."""
    total, rise = 0.0, 0.0
    zero = limit - limit
    for s in range(len(weight)):
        total += weight[s]
        upward = sign * scaled[s]
        rise += upward if (upward > zero) & (weight[s] < limit) else zero
    return total, rise


@njit(forceinline=True)
def measure_sets(net, work, trial, positive):
    """Total weight of each homeostatic set, and the most it can rise per unit of drive."""
    work.total[:] = 0.0
    work.rise[:] = 0.0
    sign = net.fading[0] if positive else -net.fading[0]
    for p in range(net.plastic):
        k = net.projections[p, SET]
        if k < 0:
            continue
        low, high = synapses_of(net, p, trial)
        total, rise = _sums(net.weight[low:high], net.eligibility[low:high], net.constants[WEIGHT_MAX], sign)
        work.total[k] += total
        work.rise[k] += rise


@njit
def _lower(weight, step):
    for s in range(len(weight)):
        weight[s] = max(weight[s] - step, step - step)


@njit(forceinline=True)
def may_exceed(net, work, trial, drive):
    """Whether some homeostatic set can have passed its limit since the last flush."""
    near = False
    for k in range(len(work.total)):
        limit = net.set_limit[trial, k]
        near |= work.total[k] + work.rise[k] * abs(drive) > limit - SLACK * limit
    return near


@njit
def dampen(net, work, trial, drive, positive):
    """Step 6, after a flush: lower the sets whose mean is too high."""
    settle_all(net, trial, drive)
    measure_sets(net, work, trial, positive)
    over = False
    for k in range(len(work.total)):
        over = over or work.total[k] > net.set_limit[trial, k]
    if over:
        for p in range(net.plastic):
            k = net.projections[p, SET]
            if k >= 0 and work.total[k] > net.set_limit[trial, k]:
                low, high = synapses_of(net, p, trial)
                _lower(net.weight[low:high], net.set_step[k])
        measure_sets(net, work, trial, positive)


@njit(forceinline=True)
def pair_spikes(net, work, trial, time, before, fading, positive):
    """Step 4: what this ms's spikes add to eligibilities; weights are settled first (up to `before`)."""
    limit = net.constants[WEIGHT_MAX]
    zero = limit - limit
    inverse = net.fading[0] / fading
    last = net.last_spike[trial]
    last_pre, soonest = (work.earlier, 0) if net.depresses else (last, 1)
    for p in range(net.plastic):
        pre, post = net.projections[p, PRE], net.projections[p, POST]
        set_, risen = net.projections[p, SET], 0.0
        start, first = net.groups[post, START], net.projections[p, FIRST_COLUMN]
        first += trial * net.groups[post, SIZE] - start
        for n in range(work.first[post], work.first[post + 1]):
            j = work.spikes[n]
            for q in range(net.columns[first + j], net.columns[first + j + 1]):
                s = net.incoming[q]
                elapsed = time - last_pre[net.source[s]]
                if elapsed < len(net.gain):
                    weight = net.weight[s] + net.eligibility[s] * (before - net.settled[s])
                    weight = limit if weight > limit else weight
                    net.weight[s] = zero if weight < zero else weight
                    net.settled[s] = before
                    change = net.gain[elapsed] * inverse
                    net.eligibility[s] += change
                    risen += change if positive else zero
        start, first = net.groups[pre, START], net.projections[p, FIRST_ROW]
        first += trial * net.groups[pre, SIZE] - start
        for n in range(work.first[pre], work.first[pre + 1]):
            i = work.spikes[n]
            for s in range(net.rows[first + i], net.rows[first + i + 1]):
                j = net.target[s]
                elapsed = time - last[j]
                if elapsed < len(net.loss) and elapsed >= soonest:
                    weight = net.weight[s] + net.eligibility[s] * (before - net.settled[s])
                    weight = limit if weight > limit else weight
                    net.weight[s] = zero if weight < zero else weight
                    net.settled[s] = before
                    change = net.loss[elapsed] * inverse
                    net.eligibility[s] -= change
                    risen += zero if positive else change
        if set_ >= 0:
            work.rise[set_] += risen
    if net.depresses:
        for n in range(work.first[len(work.first) - 1]):
            work.earlier[work.spikes[n]] = time


@njit(forceinline=True)
def send(net, work, trial, time, drive):
    """Step 7: this ms's spikes leave."""
    limit, gain = net.constants[WEIGHT_MAX], net.constants[SYNAPTIC_GAIN]
    zero = limit - limit
    slots = net.pending.shape[1]
    for p in range(net.projections.shape[0]):
        pre = net.projections[p, PRE]
        if work.first[pre] == work.first[pre + 1]:
            continue
        pending = net.pending[trial, (time + net.projections[p, DELAY]) % slots]
        first = net.projections[p, FIRST_ROW] + trial * net.groups[pre, SIZE] - net.groups[pre, START]
        for n in range(work.first[pre], work.first[pre + 1]):
            i = work.spikes[n]
            for s in range(net.rows[first + i], net.rows[first + i + 1]):
                weight = net.weight[s]
                if p < net.plastic:
                    weight += net.eligibility[s] * (drive - net.settled[s])
                    weight = limit if weight > limit else weight
                    weight = zero if weight < zero else weight
                pending[net.target[s]] += weight * gain


@njit(forceinline=True)
def draw_noise(net, work, trial, time, steps):
    """Background draws of every noisy group for a block; returns how many rows to skip."""
    at, skipped = 0, time & 3
    for g in range(net.groups.shape[0]):
        if net.groups[g, NOISY]:
            width = padded_width(net.groups[g, SIZE])
            part = work.noise[at : at + (steps + 6) * width]
            fill_bits(part, width, net.seed, net.groups[g, STREAM], net.trials[trial], time, steps)
            at += (steps + 6) * width
    return skipped


@njit(forceinline=True)
def add_background(net, work, steps, row):
    """Step 1: the background of one ms."""
    real = net.level.dtype.type
    one, two, unit = real(1.0), real(2.0), real(UNIT)
    at = 0
    for g in range(net.groups.shape[0]):
        size, start = net.groups[g, SIZE], net.groups[g, START]
        constant, noise = net.background[g, 0], net.background[g, 1]
        current = work.current[start : start + size]
        if net.groups[g, NOISY]:
            width = padded_width(size)
            drawn = work.noise[at + row * width : at + row * width + size]
            for i in range(size):
                current[i] += constant + noise * (two * (real(drawn[i]) * unit) - one)
            at += (steps + 6) * width
        elif constant != 0.0:
            for i in range(size):
                current[i] += constant


@njit(forceinline=True)
def run_block(net, work, trial, time, injected, low, high, sign, raster, reward):
    """Up to BLOCK ms of one trial, whose neurons are loaded in `work`.

    Args:
        time: of the first ms.
        injected: [steps, N]; the first row whole, of later ones only columns low to high.
        sign: of dopamine's release.
        raster: uint8 [steps, N] to be filled with who fired, or without rows.
        reward: real [steps], dopamine from outside, or without rows; None (known to the compiler) for none.
    """
    steps, neurons, groups = injected.shape[0], net.v.shape[1], net.groups.shape[0]
    slots, constants = net.pending.shape[1], net.constants
    decay, baseline, release = constants[DECAY], constants[BASELINE], constants[RELEASE]
    zero = baseline - baseline
    drive, level, total = zero, net.level[trial], net.total[trial]
    learns = net.plastic > 0 and net.modulated
    sets = len(work.total) > 0
    positive = level >= zero
    if learns and sets:
        measure_sets(net, work, trial, positive)
    skipped = draw_noise(net, work, trial, time, steps)
    current = work.current
    for k in range(steps):
        now = time + k
        arriving = net.pending[trial, now % slots]
        for i in range(neurons):
            current[i] = arriving[i]
            arriving[i] = zero
        add_background(net, work, steps, skipped + k)
        for i in range(low if k else 0, high if k else neurons):
            current[i] += injected[k, i]
        found = update_neurons(work.state, current, constants, work.spikes)
        if found:
            n = 0
            for g in range(groups):
                work.first[g] = n
                end = net.groups[g, START] + net.groups[g, SIZE]
                while n < found and work.spikes[n] < end:
                    n += 1
                net.spike_count[trial, g] += n - work.first[g]
            work.first[groups] = n
            for n in range(found):
                net.last_spike[trial, work.spikes[n]] = now
                if len(raster):
                    raster[k, work.spikes[n]] = 1
        if net.modulated:
            slot = now % net.released.shape[1]
            arrived = net.released[trial, slot]
            counts = found > 0 and net.source_group >= 0
            burst = work.first[net.source_group + 1] - work.first[net.source_group] if counts else 0
            net.released[trial, slot] = burst
            if arrived <= net.threshold:
                arrived = 0
            level = baseline + (level - baseline) * decay + sign * (release * net.level.dtype.type(arrived))
            if reward is not None and len(reward):
                level += reward[k]
            total += level
        if learns:
            if (level >= zero) != positive:
                settle_all(net, trial, drive)
                positive, drive = not positive, zero
                if sets:
                    measure_sets(net, work, trial, positive)
            before = drive
            drive = drive + net.fading[k + 1] * level
            if found:
                pair_spikes(net, work, trial, now, before, net.fading[k + 1], positive)
            if sets and may_exceed(net, work, trial, drive):
                dampen(net, work, trial, drive, positive)
                drive = zero
        if found:
            send(net, work, trial, now, drive)
    net.level[trial], net.total[trial] = level, total
    if learns:
        settle_all(net, trial, drive)
        for p in range(net.plastic):
            low, high = synapses_of(net, p, trial)
            net.eligibility[low:high] *= net.fading[steps]


@njit(forceinline=True)
def raster_of(raster, trial):
    """A trial's [T, N] of a raster [T, b, N]; without rows if the raster is of fewer trials."""
    return raster[:, trial] if trial < raster.shape[1] else raster[:0, 0]


@njit(nogil=True, cache=True)
def run_network(net, low, high, time, injected, sign, raster, reward):
    """Open loop: trials low to high through all rows of `injected` [T, B, N]; `reward` is [T, B] or [0, B]."""
    work = make_work(net)
    neurons = net.v.shape[1]
    for trial in range(low, high):
        load(net, work, trial)
        shown = raster_of(raster, trial)
        for at in range(0, injected.shape[0], BLOCK):
            rows = injected[at : at + BLOCK, trial]
            spikes = shown[at : at + BLOCK]
            rewards = reward[at : at + BLOCK, trial]
            run_block(net, work, trial, time + at, rows, 0, neurons, sign[trial], spikes, rewards)
        store(net, work, trial)
