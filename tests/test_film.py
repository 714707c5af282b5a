"""What is kept for the next picture."""

from __future__ import annotations

import torch
from helpers import make_simulation

from snnrl.recording.film import PATH, SPIKES, STEP, Film, spacing


def test_points_are_about_so_far_apart_and_cover_about_so_long_a_path() -> None:
    assert spacing(70) == (5, 28)  # 350 ms, 9.8 s
    assert spacing(1) == (STEP, PATH // STEP)
    assert spacing(20_000) == (1, 1)


def test_a_film_keeps_the_last_points_and_spikes_and_forgets_them() -> None:
    simulation = make_simulation("+experiment=food_attraction", "trials=1")
    film = Film(simulation.network, 70)
    for k in range(40):
        raster = film.raster(5)
        raster[:, 0, k] = True
        film.keep(raster)
        film.keep_position(torch.tensor([k, -k], dtype=torch.float64))
    assert film.path[:, 0].tolist() == list(range(12, 40))  # 28 points, however often there are pictures
    assert len(film.fired) == SPIKES
    assert film.fired[-350:, 39].all()
    assert film.fired[:300, 37].all()
    other = Film(simulation.network, 70, film.state_dict())
    assert other.path.equal(film.path)
    other.forget()
    assert len(other.path) == len(other.fired) == 0
    assert len(film.path) == 28
