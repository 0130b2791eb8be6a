"""A wall's uncertainty along its reach, against walls drawn at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.lidar.walls import Walls
from fgloc.report.map_walls import offset_sigma, wall_bands, wall_lengths, wall_sigmas
from tests.report.mapped import room_walls


def tilted() -> Walls:
    """A wall of 6 m seen mostly to the left of its anchor, direction and offset correlated."""
    covariance = np.array([[[0.01**2, 0.6 * 0.01 * 0.02], [0.6 * 0.01 * 0.02, 0.02**2]]])
    return Walls(
        np.array([0.7]),
        np.array([0.3]),
        np.array([[2.0, -1.0]]),
        np.array([[-1.0, 5.0]]),
        covariance,
        np.array([4]),
    )


def test_sigma_across_the_wall_against_sampling() -> None:
    wall = tilted()
    rng = np.random.default_rng(1)
    drawn = rng.multivariate_normal([0.7, 0.3], wall.covariance[0], 200_000)
    for s in (-1.0, 0.0, 2.0, 5.0):
        # The point at s of the mean line, and where each drawn line passes along the mean normal.
        normal = np.array([np.cos(0.7), np.sin(0.7)])
        tangent = np.array([-normal[1], normal[0]])
        point = wall.anchor[0] + 0.3 * normal + s * tangent
        n = np.stack([np.cos(drawn[:, 0]), np.sin(drawn[:, 0])], axis=1)
        # n · (point + λ normal - anchor) = offset
        away = (drawn[:, 1] - n @ (point - wall.anchor[0])) / (n @ normal)
        sigma = offset_sigma(wall, np.array([[s]]))[0, 0]
        np.testing.assert_allclose(sigma, away.std(), rtol=0.01)


def test_offset_is_told_at_the_middle_of_what_was_seen() -> None:
    # At s = 2: 0.02² - 2·2·0.6·0.01·0.02 + 2²·0.01² = 4e-4 - 4.8e-4 + 4e-4.
    offset, direction = wall_sigmas(tilted())
    np.testing.assert_allclose(offset, [np.sqrt(3.2e-4)])
    np.testing.assert_allclose(direction, [0.01])
    assert wall_lengths(tilted()).tolist() == [6.0]


def test_band_surrounds_the_wall() -> None:
    walls = room_walls()
    band = wall_bands(walls)[0]
    # The wall x = 3 from (3, 3), its right end as seen from inside, to (3, -3). There the band is
    # 2·sqrt(0.02² + 3²·0.01²) wide to each side, in the middle 2·0.02.
    wide = 2.0 * np.sqrt(0.02**2 + 9.0 * 0.01**2)
    np.testing.assert_allclose(band[0], [3.0 - wide, 3.0], atol=1e-12)
    np.testing.assert_allclose(band[8], [3.0 - wide, -3.0], atol=1e-12)
    np.testing.assert_allclose(band[9], [3.0 + wide, -3.0], atol=1e-12)
    np.testing.assert_allclose(band[-1], [3.0 + wide, 3.0], atol=1e-12)
    np.testing.assert_allclose(band[4], [2.96, 0.0], atol=1e-12)


def test_unknown_stays_unknown() -> None:
    unknown = replace(room_walls(), covariance=np.full((4, 2, 2), np.nan))
    assert np.isnan(wall_sigmas(unknown)).all()
    assert np.isnan(wall_bands(unknown)).all()
