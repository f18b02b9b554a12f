"""Adsorption of surfactant on the gel's surface, equations (2) and (3).

The printed recursion  vads = -p_ele (v . i) + p_ads ads  belongs to one time step, which the paper does not give. Here
it is the rate form that equals it at the paper's step D and does not depend on the integrator's step dt:

    a = p_ads^(dt/D),    vads = a ads + p_ele (-i . n) (1 - a) / (1 - p_ads),    ads = min(max(vads, 0), 1)

(for p_ads = 1 the last factor becomes dt/D).
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array


def adsorb(ads: Array, inflow: Array, p_ele: Array, p_ads: Array, dt: Array, step: Array) -> Array:
    """Adsorption after `dt` [s]: `ads` in [0, 1] and `inflow` = -i . n [A/m^2], shape (f,) each; the same comes out.

    `p_ele` [m^2/A] is the effect of the field per paper's step, `step` [s] that step, `p_ads` what remains after it.
    """
    elapsed = dt / step
    remains = p_ads**elapsed
    # expm1 and log1p keep the quotient exact as p_ads -> 1, where both its parts vanish.
    loss = jnp.maximum(1.0 - p_ads, 1e-12)
    gain = -jnp.expm1(elapsed * jnp.log1p(-loss)) / loss
    vads = remains * ads + p_ele * inflow * gain  # Eq. (2).
    return jnp.clip(vads, 0.0, 1.0)  # Eq. (3).
