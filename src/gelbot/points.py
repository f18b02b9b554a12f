"""Essential points: the centre, the body's normal and the tips, from the node positions (Sections IV-B, IV-D)."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gelbot.body.lattice import Body


class EssentialPoints(NamedTuple):
    """How to read the points: weights over the nodes, `centre` (n,), `tips` and `tip_bases` (a, n), and the `hub`.

    `hub` (3, m): triangles around the centre, of columns of nodes, `hub_nodes` (l, c), one for each of l layers: the
    normal belongs to the mid-surface.
    """

    centre: Array
    tips: Array
    tip_bases: Array
    hub: Array
    hub_nodes: Array


class Observation(NamedTuple):
    """What a camera would see: `centre` [m] (3,), `normal` (3,) of the body's upper side, `tips` [m] (3, a).

    `tip_angles` [rad] (a,): how far each tip points below its own outward direction: 0 flat, pi/2 vertical
    downwards, more when curled inwards, negative when it points up.
    """

    centre: Array
    normal: Array
    tips: Array
    tip_angles: Array


def essential_points(body: Body) -> EssentialPoints:
    """The essential points of a body: its centre, tips and middle."""
    columns, hub = np.unique(body.hub, return_inverse=True)
    # Faces know the corners of the mesh only; a body may have nodes between them.
    per_layer = (int(body.faces.max()) + 1) // body.layer_count
    return EssentialPoints(
        centre=jnp.asarray(body.centre),
        tips=jnp.asarray(body.tips),
        tip_bases=jnp.asarray(body.tip_bases),
        hub=jnp.asarray(hub.reshape(body.hub.shape)),
        hub_nodes=jnp.asarray(columns + per_layer * np.arange(body.layer_count)[:, None], jnp.int32),
    )


@jax.jit
def observe(points: EssentialPoints, positions: Array) -> Observation:
    """Read the essential points from node `positions` [m], shape (3, n), or (3, n, b) for a batch."""
    centre = jnp.einsum("in...,n->i...", positions, points.centre)
    tips, bases = (jnp.einsum("in...,an->ia...", positions, weights) for weights in (points.tips, points.tip_bases))
    outward = (bases - centre[:, None]).at[2].set(0.0)
    outward = outward / jnp.maximum(jnp.sqrt(jnp.sum(outward**2, axis=0)), 1e-12)
    along = tips - bases
    return Observation(
        centre=centre,
        normal=body_frame(points, positions)[:, 2],
        tips=tips,
        tip_angles=jnp.arctan2(-along[2], jnp.sum(along * outward, axis=0)),
    )


def essential(seen: Observation) -> Array:
    """The essential points [m] of an observation, (3, 1 + a): the centre, then the `a` tips."""
    return jnp.concatenate([seen.centre[:, None], seen.tips], axis=1)


def body_frame(points: EssentialPoints, positions: Array) -> Array:
    """An orthonormal frame (3, 3) that turns with the middle of the body: two columns in its plane, then its normal."""
    columns = jnp.mean(positions[:, points.hub_nodes], axis=1)
    a, b, c = (columns[:, points.hub[k]] for k in range(3))
    normal = jnp.sum(jnp.cross(b - a, c - a, axis=0), axis=1)
    normal = normal / jnp.maximum(jnp.sqrt(jnp.sum(normal**2, axis=0)), 1e-30)
    # The first triangle is a fixed mark on the body; its edge gives the direction in the plane.
    mark = (b - a)[:, 0]
    first = mark - normal * jnp.sum(mark * normal, axis=0)
    first = first / jnp.maximum(jnp.sqrt(jnp.sum(first**2, axis=0)), 1e-30)
    return jnp.stack([first, jnp.cross(normal, first, axis=0), normal], axis=1)
