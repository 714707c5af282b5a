"""Dense projections that learn, as matrices: all pairs of a postsynaptic neuron and of the neurons that reach it.

A row is a postsynaptic neuron's, of tiles of LANES pairs each, and a tile holds their weights and their `scaled` (see
`plasticity`) side by side. So a postsynaptic spike is a pass along a row, and the presynaptic spikes of one ms are
passes down the columns of tiles that they fall in. A pair was last settled when one of its two neurons last fired: its
`settled` is the later of its row's and its column's. Where it has no synapse, weight and `scaled` stay 0.
"""

from __future__ import annotations

from snnrl.engines.fused.plasticity import feed, look_up, risen, settled_weight
from snnrl.engines.fused.vectors import LANE_BITS, LANES, across, as_double, bits_mask, load, put, select, store, take
from snnrl.engines.layout import (
    ADDS_UP,
    BY_RULE,
    DELAY,
    DEPRESSES,
    FROM,
    GAINS,
    GAINS_END,
    LISTENS,
    LOSSES,
    LOSSES_END,
    MEMBER,
    MEMBERS,
    MEMBERS_END,
    OF_SET,
    OFFSET,
    ONTO,
    PLACE,
    RISE,
    ROW,
    ROWS,
    SIZE,
    TILE,
    WIDTH,
)
from snnrl.model.homeostasis import lowered

SCALED, ALL = LANES, 2 * LANES  # within a tile, and to the next


def entry(tile, slot):
    """Where in `tiles` the weight of a pair is, by the first tile of its row and its place in that."""
    return (tile + (slot >> LANE_BITS)) * ALL + (slot & (LANES - 1))


def fill_tiles(t, s, w, trial):
    """Lay out the synapses of a trial."""
    w.tiles[:] = 0.0
    w.masks[:] = 0
    w.row_settled[:] = 0.0
    w.column_settled[:] = 0.0
    for d in range(t.matrices.shape[0]):
        each_synapse(t, s, w, trial, d, True)


def empty_tiles(t, s, w, trial):
    """Put the synapses of a trial back where they were."""
    for d in range(t.matrices.shape[0]):
        each_synapse(t, s, w, trial, d, False)


def each_synapse(t, s, w, trial, d, loading):
    """Copy the synapses of a matrix, there or back."""
    place = t.groups[t.matrices[d, ONTO], PLACE]
    for e in range(t.matrices[d, MEMBERS], t.matrices[d, MEMBERS_END]):
        size = t.groups[t.members[e, FROM], SIZE]
        row = t.projections[t.members[e, MEMBER], ROWS] + trial * size
        for i in range(size):
            slot = t.members[e, OFFSET] + i
            for k in range(t.rows[row + i], t.rows[row + i + 1]):
                tile = t.matrices[d, TILE] + (t.target[k] - place) * t.matrices[d, WIDTH]
                at = entry(tile, slot)
                if loading:
                    w.tiles[at], w.tiles[at + SCALED] = s.weight[k], s.eligibility[k]
                    w.masks[tile + (slot >> LANE_BITS)] |= 1 << (slot & (LANES - 1))
                else:
                    s.weight[k], s.eligibility[k] = w.tiles[at], w.tiles[at + SCALED]


def later(one, other, grown):
    """Of two drives the one that was reached later: since 0 they have only grown, or only fallen."""
    return select(one > other, one, other) if grown else select(one < other, one, other)


def settle_tiles(t, w, d, fading):
    """Bring every weight up to date; `scaled` times `fading` is what stays of the eligibility.

    Returns the sum of the weights, and of |scaled| where that makes a weight rise.
    """
    rule, signal, width, columns = (
        t.matrices[d, BY_RULE],
        t.matrices[d, LISTENS],
        t.matrices[d, WIDTH],
        t.matrices[d, RISE],
    )
    drive, positive, most, adds_up = w.drive[signal], w.positive[signal], t.most[rule], t.rules[rule, ADDS_UP]
    nothing = load(w.tiles, 0) * 0.0
    total, rise = as_double(nothing), as_double(nothing)
    for j in range(t.groups[t.matrices[d, ONTO], SIZE]):
        along, upwards, row = nothing, nothing, nothing + w.row_settled[t.matrices[d, ROW] + j]
        for b in range(width):
            tile = t.matrices[d, TILE] + j * width + b
            at = tile * ALL
            weight, scaled = load(w.tiles, at), load(w.tiles, at + SCALED)
            if adds_up:
                settled = later(row, load(w.column_settled, columns + b * LANES), drive > 0.0)
                weight = settled_weight(t, rule, weight, scaled, drive - settled)
                weight = select(bits_mask(w.masks[tile]), weight, nothing)
                store(w.tiles, at, weight)
            scaled = scaled * fading
            store(w.tiles, at + SCALED, scaled)
            upward = scaled if positive else -scaled
            along = along + weight
            upwards = upwards + select((upward > 0.0) & (weight < most), upward, nothing)
        total, rise = total + as_double(along), rise + as_double(upwards)
        w.row_settled[t.matrices[d, ROW] + j] = 0.0
    for b in range(width):
        store(w.column_settled, columns + b * LANES, nothing)
    return across(total), across(rise)


def update_tiles(t, w, d, change):
    """Step 5 of a matrix whose rule does not add up: every weight, for one ms."""
    rule, first = t.matrices[d, BY_RULE], t.matrices[d, TILE]
    for tile in range(first, first + t.groups[t.matrices[d, ONTO], SIZE] * t.matrices[d, WIDTH]):
        at = tile * ALL
        weight = load(w.tiles, at)
        after = settled_weight(t, rule, weight, load(w.tiles, at + SCALED), change)
        store(w.tiles, at, select(bits_mask(w.masks[tile]), after, weight))


def lower_tiles(t, w, d, step):
    """Lower every weight."""
    first, least = t.matrices[d, TILE], t.least[t.matrices[d, BY_RULE]]
    for tile in range(first, first + t.groups[t.matrices[d, ONTO], SIZE] * t.matrices[d, WIDTH]):
        weight = load(w.tiles, tile * ALL)
        store(w.tiles, tile * ALL, select(bits_mask(w.masks[tile]), lowered(weight, step, least), weight))


def reaching(t, w, d):
    """How many presynaptic neurons of a matrix fire in this ms."""
    found = 0
    for e in range(t.matrices[d, MEMBERS], t.matrices[d, MEMBERS_END]):
        found += w.first[t.members[e, FROM] + 1] - w.first[t.members[e, FROM]]
    return found


def pair_tiles(t, w, now, d, power, through):
    """Step 4 of a matrix: what this ms's spikes add to eligibilities; weights are settled first.

    With `through`, those that presynaptic spikes pass are also brought up to date with this ms's signal.
    """
    rule, post, set_ = t.matrices[d, BY_RULE], t.matrices[d, ONTO], t.matrices[d, OF_SET]
    growing, positive = t.growing[rule, power], w.positive[t.matrices[d, LISTENS]]
    gains, losses, alone = t.rules[rule, GAINS], t.rules[rule, LOSSES], t.windows[t.rules[rule, GAINS]]
    depresses = t.rules[rule, DEPRESSES]
    after = w.first[post + 1] - w.first[post]
    if after:
        at = t.matrices[d, RISE]
        # the pair of spikes of one ms, if it is the only one, is made with the presynaptic one, below
        last, together = (w.earlier, alone) if depresses else (w.last, alone * 0.0)
        for e in range(t.matrices[d, MEMBERS], t.matrices[d, MEMBERS_END]):
            there = at + t.members[e, OFFSET]
            look_up(t, w.rise, there, t.members[e, FROM], last, now, gains, t.rules[rule, GAINS_END], together)
        along_rows(t, w, d, growing)
        if set_ >= 0:
            w.rising[set_] += after * growing * risen(w.rise, at, t.matrices[d, WIDTH] * LANES, positive)
    before = reaching(t, w, d)
    if before:
        together = t.windows[losses] if depresses else alone
        place = t.groups[post, PLACE]
        look_up(t, w.fall, place, post, w.last, now, losses, t.rules[rule, LOSSES_END], together)
        down_columns(t, w, d, growing, through)
        if set_ >= 0:
            w.rising[set_] += before * growing * risen(w.fall, place, t.groups[post, SIZE], positive)


def along_rows(t, w, d, growing):
    """The pairs of this ms's postsynaptic spikes."""
    rule, signal, width = t.matrices[d, BY_RULE], t.matrices[d, LISTENS], t.matrices[d, WIDTH]
    drive, positive, adds_up = w.before[signal], w.positive[signal], t.rules[rule, ADDS_UP]
    columns, place = t.matrices[d, RISE], t.groups[t.matrices[d, ONTO], PLACE]
    for n in range(w.first[t.matrices[d, ONTO]], w.first[t.matrices[d, ONTO] + 1]):
        j = w.spikes[n] - place
        row = load(w.tiles, 0) * 0.0 + w.row_settled[t.matrices[d, ROW] + j]
        for b in range(width):
            tile = t.matrices[d, TILE] + j * width + b
            at, mine = tile * ALL, bits_mask(w.masks[tile])
            scaled, rise = load(w.tiles, at + SCALED), load(w.rise, columns + b * LANES)
            if adds_up:
                old, settled = load(w.tiles, at), later(row, load(w.column_settled, columns + b * LANES), positive)
                store(w.tiles, at, select(mine, settled_weight(t, rule, old, scaled, drive - settled), old))
            store(w.tiles, at + SCALED, select(mine, scaled + rise * growing, scaled))
        if adds_up:
            w.row_settled[t.matrices[d, ROW] + j] = drive


def down_columns(t, w, d, growing, through):
    """The pairs of this ms's presynaptic spikes."""
    rule, signal, width = t.matrices[d, BY_RULE], t.matrices[d, LISTENS], t.matrices[d, WIDTH]
    before, drive, positive = w.before[signal], w.drive[signal], w.positive[signal]
    adds_up, place, size = (
        t.rules[rule, ADDS_UP],
        t.groups[t.matrices[d, ONTO], PLACE],
        t.groups[t.matrices[d, ONTO], SIZE],
    )
    note_lanes(t, w, d)
    for b in range(width):
        if w.lanes[b] == 0:
            continue
        column = load(w.column_settled, t.matrices[d, RISE] + b * LANES)
        for j in range(size):
            tile = t.matrices[d, TILE] + j * width + b
            at, mine = tile * ALL, bits_mask(w.masks[tile] & w.lanes[b])
            scaled = load(w.tiles, at + SCALED)
            eligible = select(mine, scaled + take(w.fall, place + j) * growing, scaled)
            store(w.tiles, at + SCALED, eligible)
            if adds_up:
                old = load(w.tiles, at)
                settled = later(column, column * 0.0 + w.row_settled[t.matrices[d, ROW] + j], positive)
                weight = settled_weight(t, rule, old, scaled, before - settled)
                if through:
                    weight = settled_weight(t, rule, weight, eligible, drive - before)
                store(w.tiles, at, select(mine, weight, old))
        if adds_up:
            reached = column * 0.0 + (drive if through else before)
            store(w.column_settled, t.matrices[d, RISE] + b * LANES, select(bits_mask(w.lanes[b]), reached, column))


def note_lanes(t, w, d):
    """In which columns of tiles presynaptic neurons fire, and where in these."""
    for b in range(t.matrices[d, WIDTH]):
        w.lanes[b] = 0
    for e in range(t.matrices[d, MEMBERS], t.matrices[d, MEMBERS_END]):
        pre = t.members[e, FROM]
        for n in range(w.first[pre], w.first[pre + 1]):
            slot = t.members[e, OFFSET] + w.spikes[n] - t.groups[pre, PLACE]
            w.lanes[slot >> LANE_BITS] |= 1 << (slot & (LANES - 1))


def send_tiles(t, w, now, d, slots, up_to_date):
    """Step 7 of a matrix; with `up_to_date`, its weights need not be settled for it."""
    rule, post, stride = t.matrices[d, BY_RULE], t.matrices[d, ONTO], t.matrices[d, WIDTH] * ALL
    signal, row, size = t.matrices[d, LISTENS], t.matrices[d, ROW], t.groups[post, SIZE]
    drive, positive = w.drive[signal], w.positive[signal]
    for e in range(t.matrices[d, MEMBERS], t.matrices[d, MEMBERS_END]):
        pre = t.members[e, FROM]
        if w.first[pre] == w.first[pre + 1]:
            continue
        arrives = (now + t.projections[t.members[e, MEMBER], DELAY]) % slots
        there = arrives * t.places + t.groups[post, PLACE]
        for n in range(w.first[pre], w.first[pre + 1]):
            slot = t.members[e, OFFSET] + w.spikes[n] - t.groups[pre, PLACE]
            at = entry(t.matrices[d, TILE], slot)
            if up_to_date:
                for j in range(size):
                    sent = take(w.tiles, at + j * stride) * t.gain
                    put(w.pending, there + j, take(w.pending, there + j) + sent)
            else:
                column = w.column_settled[t.matrices[d, RISE] + slot]
                for j in range(size):
                    old, scaled = take(w.tiles, at + j * stride), take(w.tiles, at + j * stride + SCALED)
                    one = w.row_settled[row + j]
                    settled = max(one, column) if positive else min(one, column)
                    weight = settled_weight(t, rule, old, scaled, drive - settled)
                    if scaled != 0.0:  # else it is not due to be changed, or there is no synapse
                        old = weight
                    put(w.pending, there + j, take(w.pending, there + j) + old * t.gain)
        feed(t, w, arrives, t.groups[post, PLACE], size)
