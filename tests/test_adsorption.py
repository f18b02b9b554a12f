"""Adsorption, equations (2) and (3).

| identity | one road | the other |
|---|---|---|
| dt = D | `adsorb` | the printed recursion, written out for one face |
| any dt | many short steps | one long step of the same length (no clipping on the way) |
| p_ads -> 1 | `adsorb` with p_ads = 1 | ads + p_ele inflow dt / D |
| continuous time | `adsorb` | the solution of da/dt = -lambda a + c with lambda = -ln(p_ads)/D |
"""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelbot.adsorption import adsorb

D = 1.0
P_ELE = 2e-3  # m^2/A, 0.02 cm^2/mA


def printed(ads: float, i_normal: float, p_ele: float, p_ads: float) -> float:
    """Equations (2) and (3) as the paper prints them, one face, one of the paper's steps."""
    vads = -p_ele * i_normal + p_ads * ads
    if vads < 0.0:
        return 0.0
    if vads > 1.0:
        return 1.0
    return vads


@pytest.mark.parametrize("p_ads", [0.5, 0.99, 0.9999, 1.0])
def test_equals_the_printed_recursion_at_the_papers_step(p_ads, rng):
    i_normal = rng.uniform(-150.0, 150.0, (30, 6))
    mine, theirs = jnp.full(6, 0.4), [0.4] * 6
    for row in i_normal:
        mine = adsorb(mine, jnp.asarray(-row), P_ELE, p_ads, D, D)
        theirs = [printed(a, i, P_ELE, p_ads) for a, i in zip(theirs, row, strict=True)]
        assert np.asarray(mine) == pytest.approx(theirs, abs=1e-12)


@pytest.mark.parametrize("p_ads", [0.9, 0.999, 0.9999, 1.0])
@pytest.mark.parametrize("pieces", [2, 7, 20, 50])
def test_does_not_depend_on_the_time_step(p_ads, pieces):
    start, inflow = jnp.array([0.3, 0.5, 0.6]), jnp.array([20.0, 0.0, -15.0])
    whole = adsorb(start, inflow, P_ELE, p_ads, 5.0, D)
    ads = start
    for _ in range(pieces):
        ads = adsorb(ads, inflow, P_ELE, p_ads, 5.0 / pieces, D)
    assert float(jnp.min(whole)) > 0.0
    assert float(jnp.max(whole)) < 1.0
    assert np.asarray(ads) == pytest.approx(np.asarray(whole), abs=1e-12)


def test_is_the_exponential_of_its_rate():
    p_ads, ads, inflow, t = 0.98, 0.2, 8.0, 3.7
    decay = -np.log(p_ads) / D
    # The rate that reproduces one printed step: it gains p_ele inflow per step against the loss (1 - p_ads).
    gain = P_ELE * inflow * decay / (1.0 - p_ads)
    exact = gain / decay + (ads - gain / decay) * np.exp(-decay * t)
    assert float(adsorb(jnp.asarray(ads), jnp.asarray(inflow), P_ELE, p_ads, t, D)) == pytest.approx(exact, abs=1e-12)


def test_limit_of_no_loss():
    for dt in (0.01, 0.1, 1.0):
        gained = float(adsorb(jnp.asarray(0.1), jnp.asarray(50.0), P_ELE, 1.0, dt, D))
        assert gained == pytest.approx(0.1 + P_ELE * 50.0 * dt / D, rel=1e-9)
        nearly = float(adsorb(jnp.asarray(0.1), jnp.asarray(50.0), P_ELE, 1.0 - 1e-9, dt, D))
        assert nearly == pytest.approx(gained, rel=1e-7)


def test_current_that_enters_adsorbs_and_current_that_leaves_desorbs():
    i, n = np.array([0.0, 0.0, 10.0]), np.array([0.0, 0.0, -1.0])  # rising current, the gel's lower face
    inflow = -float(i @ n)
    assert float(adsorb(jnp.asarray(0.5), jnp.asarray(inflow), P_ELE, 1.0, D, D)) > 0.5
    assert float(adsorb(jnp.asarray(0.5), jnp.asarray(-inflow), P_ELE, 1.0, D, D)) < 0.5


def test_clips_at_both_ends():
    ends = adsorb(jnp.array([0.9, 0.1]), jnp.array([1e4, -1e4]), P_ELE, 0.999, D, D)
    assert np.asarray(ends) == pytest.approx([1.0, 0.0], abs=0.0)


@given(
    st.floats(0.0, 1.0),
    st.floats(-1e6, 1e6),
    st.floats(0.0, 1.0),
    st.floats(1e-6, 1.0),
    st.floats(1e-4, 100.0),
    st.floats(0.1, 10.0),
)
def test_stays_between_zero_and_one(ads, inflow, p_ele, p_ads, dt, step):
    after = float(adsorb(jnp.asarray(ads), jnp.asarray(inflow), p_ele, p_ads, dt, step))
    assert 0.0 <= after <= 1.0


def test_uses_single_precision_well():
    """With p_ads = 0.9999 and steps of 1 ms the loss is 1e-7 of ads: the quotient must not cancel."""
    single = [jnp.asarray(v, jnp.float32) for v in (0.3, 20.0, P_ELE, 0.9999, 1e-3, 1.0)]
    gained = adsorb(*single) - single[0]
    exact = P_ELE * 20.0 * 1e-3 - 0.3 * 1e-7
    assert float(gained) == pytest.approx(exact, abs=3e-8)
