"""The planar linkage, equations (1), (4), (5), beside closed forms.

| identity | one road | the other |
|---|---|---|
| constant curvature | joints of `bend` | points of a circle's arc |
| Eq. (5), (4) | the module | the printed lines, link by link |
| p_l = 2 p_dv / l | `p_l_from_p_dv` | the trapezoid of two layers, one of them shorter, as a drawing |
| fit | `fit_p_dv` of a bent linkage | the p_dv that bent it |
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelbot.errors import BadInput
from gelbot.linkage import bend, fit_p_dv, joints, orientations, p_dv_from_p_l, p_l_from_p_dv, turning_angles


def test_equations_4_and_5_link_by_link(rng):
    ads, h, p_dv = rng.uniform(0, 1, 9), rng.uniform(0.5e-3, 1e-3, 9), 2e-4
    gel = bend(ads, h, p_dv, 1e-3)
    for j in range(1, 9):
        dv = 2.0 * p_dv / (h[j - 1] + h[j]) * (ads[j - 1] + ads[j])
        assert gel.v[j] == pytest.approx(gel.v[j - 1] + dv, abs=1e-14)
    assert np.array_equal(gel.ads, ads)
    assert np.array_equal(gel.h, h)


def test_uniform_adsorption_is_an_arc():
    count, length, p_dv, h, ads = 40, 0.5e-3, 1e-4, 1e-3, 0.7
    gel = bend(np.full(count, ads), h, p_dv, length)
    dv = 2.0 * p_dv * ads / h
    radius = length / (2.0 * np.sin(dv / 2.0))  # a polygon with sides l that turns by dv has this circumcircle
    corners = joints(gel.v, length)
    # The circle's centre lies across the middle of the first link.
    centre = np.array([length / 2.0, length / (2.0 * np.tan(dv / 2.0))])
    assert np.linalg.norm(corners - centre[:, None], axis=0) == pytest.approx(np.full(count + 1, radius), rel=1e-12)
    assert np.linalg.norm(gel.r - centre[:, None], axis=0) == pytest.approx(
        np.full(count, radius * np.cos(dv / 2.0)), rel=1e-12
    )


def test_links_keep_their_length_and_bend_towards_the_adsorbing_side(rng):
    gel = bend(rng.uniform(0.1, 1, 20), 1e-3, 5e-5, 1e-3)
    assert np.linalg.norm(np.diff(joints(gel.v, 1e-3), axis=1), axis=0) == pytest.approx(np.full(20, 1e-3))
    assert np.all(np.diff(gel.r[1]) > 0.0)
    assert bend(np.zeros(5), 1e-3, 5e-5, 1e-3).r[1] == pytest.approx(np.zeros(5), abs=0.0)


def test_orientations_begin_where_told():
    assert orientations(np.array([0.1, 0.2]), 0.5) == pytest.approx([0.5, 0.6, 0.8])


def test_p_l_is_the_turn_of_two_layers():
    """Links of length l, one side shorter by p_l ads: isosceles trapezoids on legs of h, glued leg to leg."""
    length, h, p_dv = 0.8e-3, 0.9e-3, 1e-7
    p_l = p_l_from_p_dv(p_dv, length)
    shorter = length * (1.0 - p_l)
    # Half the difference of the parallel sides over the leg is the sine of half the turn.
    turn = 2.0 * np.arcsin((length - shorter) / (2.0 * h))
    dv = turning_angles(np.ones(2), np.full(2, h), p_dv)[0]
    assert dv == pytest.approx(turn, rel=1e-6)
    assert dv == pytest.approx(p_l * length / h, rel=1e-12)
    assert dv == pytest.approx(2.0 * p_dv / h, rel=1e-12)


@given(st.floats(0.0, 1.0), st.floats(1e-4, 1e-2))
def test_p_l_and_p_dv_are_inverse(p_l, length):
    assert p_l_from_p_dv(p_dv_from_p_l(p_l, length), length) == pytest.approx(p_l, rel=1e-12)


def test_fit_recovers_p_dv(rng):
    ads, h = rng.uniform(0, 1, 60), rng.uniform(0.8e-3, 1.2e-3, 60)
    dv = turning_angles(ads, h, 3e-4)
    assert fit_p_dv(dv, ads, h) == pytest.approx(3e-4, rel=1e-12)
    noisy = dv + rng.normal(0.0, 0.02, dv.shape)
    best = fit_p_dv(noisy, ads, h)

    def misfit(p_dv: float) -> float:
        return float(np.sum((turning_angles(ads, h, p_dv) - noisy) ** 2))

    assert misfit(best) < min(misfit(best * 1.001), misfit(best * 0.999))


def test_fit_needs_adsorption():
    with pytest.raises(BadInput, match="without adsorption"):
        fit_p_dv(np.zeros(3), np.zeros(4), np.full(4, 1e-3))
