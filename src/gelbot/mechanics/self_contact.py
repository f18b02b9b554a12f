"""Where the body meets itself: which of its surface nodes and faces, and of its edges, are near, and how near.

A pair is a node and a face or two edges, four nodes in all. Its distance is that of two points, weighted means of them:

    d = |sum_k w_k x_k|,    d d / d x_k = w_k n,    n = sum_k w_k x_k / d,

with weights that sum to 1 on the first side and to -1 on the second. What the weights change by does not count, since
the points are the closest ones (envelope theorem). Distances have no sign: a body whose pairs never come to zero does
not pass through itself (Li et al., Incremental Potential Contact, 2020), and no face has to know its outer side.

`find_pairs` looks for what is near, seldom; parts that are neighbours at rest are no pairs.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from gelbot.mechanics.batch import dot, settled

EXCLUSION = 1.0
"""Parts whose middles are closer at rest than this, times thickness + mesh size, are neighbours."""
BLOCK = 64
"""Numbers that are summed up at once."""
FLAT = 1e-6
"""Squared sine of an angle that counts as zero: single precision cannot tell."""
TINY = 1e-30
"""Keeps what is divided by a squared length [m^2] finite."""


class ContactSurface(NamedTuple):
    """Constants of a closed triangulated surface; index letters m surface nodes, f faces, e edges.

    `nodes` (1, m), `faces` (3, f), `edges` (2, e); `node_face` (m, f), `edge_edge` (e, e): which of them are no
    neighbours at rest, each pair once. Contact begins at a distance of `layer` [m]; candidates are looked for `margin`
    [m] farther. Places for near pairs and for candidates, `*_places`, are 0, 1, 2, ...: their lengths are the
    capacities.
    """

    nodes: Array
    faces: Array
    edges: Array
    node_face: Array
    edge_edge: Array
    layer: Array
    margin: Array
    node_face_places: tuple[Array, Array]
    edge_edge_places: tuple[Array, Array]


class ContactPairs(NamedTuple):
    """Candidates: `node_face` (4, c'), a node and the corners of a face; `edge_edge` (4, c"), the ends of two edges.

    `valid` (c' + c",): which places are taken; `found` of them are, `missed` more got no place.
    `local` [m] (3, n): where the nodes were, seen from the body.
    """

    node_face: Array
    edge_edge: Array
    valid: Array
    found: Array
    missed: Array
    local: Array


def contact_surface(
    faces: NDArray[np.int64],
    rest: NDArray[np.float64],
    thickness: float,
    mesh_size: float,
    layer: float,
    margin: float,
    contacts_per_node: float = 2.0,
) -> ContactSurface:
    """Prepare a closed surface of `faces` (3, f) at `rest` [m] (3, n).

    There is room for `contacts_per_node` candidates for each surface node and for each edge.
    """
    exclusion = EXCLUSION * (thickness + mesh_size)
    nodes, edges = np.unique(faces)[None], _edges(faces)
    node_room, edge_room = (int(np.ceil(contacts_per_node * m)) for m in (nodes.shape[1], edges.shape[1]))
    return ContactSurface(
        nodes=jnp.asarray(nodes),
        faces=jnp.asarray(faces),
        edges=jnp.asarray(edges),
        node_face=jnp.asarray(_apart(rest, nodes, faces, exclusion)),
        edge_edge=jnp.asarray(np.triu(_apart(rest, edges, edges, exclusion))),
        layer=jnp.asarray(layer),
        margin=jnp.asarray(margin),
        node_face_places=(jnp.arange(8 * node_room), jnp.arange(node_room)),
        edge_edge_places=(jnp.arange(8 * edge_room), jnp.arange(edge_room)),
    )


def _edges(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """The edges (2, e) of a closed surface."""
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=0).ravel()
    edges, times = np.unique(np.sort([tails, heads], axis=0), axis=1, return_counts=True)
    if np.any(times != 2) or len(np.unique(np.stack([tails, heads]), axis=1).T) != len(tails):
        raise ValueError("the surface is not closed, or not all of its faces are turned the same way")
    return edges


def _apart(
    rest: NDArray[np.float64], first: NDArray[np.int64], second: NDArray[np.int64], exclusion: float
) -> NDArray[np.bool_]:
    """Whether the middles of simplices (d, .) at `rest` [m] are at least `exclusion` [m] apart, (., .)."""
    one, other = (rest[:, simplices].mean(axis=1) for simplices in (first, second))
    x, y, z = (np.subtract.outer(one[k], other[k]) for k in range(3))
    return x**2 + y**2 + z**2 >= exclusion**2


def _each_robot(one: Callable[..., Any]) -> Callable[..., Any]:
    """Let a function of one robot, (surface, ..., positions (3, n), ...), take a batch along the last axes too."""

    @wraps(one)
    def each(surface: ContactSurface, *moving: Any) -> Any:
        batched = any(isinstance(part, Array) and part.ndim == 3 for part in moving)
        if not batched:
            return one(surface, *moving)
        return jax.vmap(one, in_axes=(None, *(-1 for _ in moving)), out_axes=-1)(surface, *moving)

    return each


@_each_robot
def find_pairs(surface: ContactSurface, positions: Array, frame: Array) -> ContactPairs:
    """What lies within layer + margin of each other.

    `positions` [m] (3, n[, b]); `frame` (3, 3[, b]) turns with the body, its columns are the body's axes.
    """
    node_face, met, missed = _near(
        surface, positions, surface.nodes, surface.faces, surface.node_face, surface.node_face_places
    )
    edge_edge, crossed, missed_edges = _near(
        surface, positions, surface.edges, surface.edges, surface.edge_edge, surface.edge_edge_places
    )
    valid = jnp.concatenate([met, crossed])
    local = frame.T.astype(positions.dtype) @ from_middle(positions)
    return ContactPairs(node_face, edge_edge, valid, jnp.sum(valid), missed + missed_edges, local)


def refreshed(surface: ContactSurface, pairs: ContactPairs, positions: Array, frame: Array) -> ContactPairs:
    """`pairs`, or new ones where the body at `positions` [m] has changed its shape since they were found."""
    old = jnp.any(stale(surface, pairs, positions, frame))
    return jax.lax.cond(old, lambda: find_pairs(surface, positions, frame), lambda: pairs)


@_each_robot
def stale(surface: ContactSurface, pairs: ContactPairs, positions: Array, frame: Array) -> Array:
    """Whether some node has moved more than margin / 4, seen from the body, since `pairs` were found; shape () or (b,).

    Nothing else can touch before some node has moved margin / 2. Rigid motions change no distance: how well `frame`
    (3, 3[, b]) follows the body decides only how often to look.
    """
    moved = changed(pairs, positions, frame)
    return jnp.max(dot(moved, moved)) > (0.25 * surface.margin) ** 2


def changed(pairs: ContactPairs, positions: Array, frame: Array) -> Array:
    """How far the nodes at `positions` [m] have moved, seen from the body, since `pairs` were found, (3, n[, b])."""
    return from_middle(positions) - jnp.einsum("ij...,jn...->in...", frame.astype(positions.dtype), pairs.local)


def from_middle(positions: Array) -> Array:
    """`positions` (3, n[, b]) from their mean."""
    return positions - jnp.mean(positions, axis=1, keepdims=True)


def _near(
    surface: ContactSurface,
    positions: Array,
    first: Array,
    second: Array,
    apart: Array,
    places: tuple[Array, Array],
) -> tuple[Array, Array, Array]:
    """Pairs of simplices `first` (d, .) and `second` (4 - d, .) nearer than layer + margin, of those that are `apart`.

    Nodes of both (4, c), which of them are real (c,), and how many got no place.
    """
    reach = surface.layer + surface.margin
    (centre_1, radius_1), (centre_2, radius_2) = _balls(positions, first), _balls(positions, second)
    between = centre_1[:, :, None] - centre_2[:, None]
    near = settled(apart & (dot(between, between) < (radius_1[:, None] + (radius_2 + reach)) ** 2))
    place, taken, lost = _first_places(near, places[0])
    nodes = jnp.concatenate([first[:, place // apart.shape[1]], second[:, place % apart.shape[1]]])
    corners = settled(positions[:, nodes])
    away = jnp.sum(closest_weights(corners, first.shape[0]) * corners, axis=1)
    place, found, missed = _first_places(taken & (dot(away, away) < reach**2), places[1])
    return nodes[:, place], found, lost + missed


def _balls(positions: Array, simplices: Array) -> tuple[Array, Array]:
    """Centres (3, .) and radii [m] (.,) of balls around `simplices` (d, .)."""
    corners = positions[:, simplices]
    centre = jnp.mean(corners, axis=1)
    out = corners - centre[:, None]
    return centre, jnp.sqrt(jnp.max(dot(out, out), axis=0))


def _first_places(found: Array, places: Array) -> tuple[Array, Array, Array]:
    """Indices of the first true entries of `found`, one for each place; which places are taken; how many got none."""
    # Running sums are slow: they are taken over words of 32 bits, and the bits in a word found by halving it.
    size = found.size
    bits = jnp.pad(found.ravel(), (0, -size % (32 * BLOCK))).reshape(-1, 32)
    words = jnp.sum(jnp.where(bits, jnp.uint32(1) << jnp.arange(32, dtype=jnp.uint32), 0), axis=1, dtype=jnp.uint32)
    running = _running_sum(jax.lax.population_count(words))
    order = places.astype(jnp.int32)
    word = jnp.minimum(jnp.searchsorted(running, order + 1), words.shape[0] - 1)
    rest, before = words[word], order - jnp.where(word > 0, running[word - 1], 0)
    index = 32 * word.astype(jnp.int32)
    for width in (16, 8, 4, 2, 1):
        below = jax.lax.population_count(rest & jnp.uint32(2**width - 1)).astype(jnp.int32)
        later = before >= below
        rest = jnp.where(later, rest >> width, rest)
        before, index = before - jnp.where(later, below, 0), index + jnp.where(later, width, 0)
    return jnp.minimum(index, size - 1), order < running[-1], jnp.maximum(0, running[-1] - order.shape[0])


def _running_sum(counts: Array) -> Array:
    """Sums (w,) of `counts` up to each, w a multiple of BLOCK: matrix products compile and run faster than a scan."""
    blocks = counts.reshape(-1, BLOCK).astype(jnp.float32)  # exact up to 2^24
    within = blocks @ jnp.triu(jnp.ones((BLOCK, BLOCK), jnp.float32))
    before = jnp.tril(jnp.ones((len(blocks), len(blocks)), jnp.float32), -1) @ within[:, -1]
    return (within + before[:, None]).ravel().astype(jnp.int32)


def closest_weights(corners: Array, first: int) -> Array:
    """Signed weights (4, c) of the closest points of pairs at `corners` [m] (3, 4, c), `first` on the first side."""
    y = corners.swapaxes(0, 1)
    return node_face_weights(*y) if first == 1 else edge_edge_weights(*y)


def node_face_weights(p: Array, a: Array, b: Array, c: Array) -> Array:
    """Weights (4, c) that take p and the corners of a triangle, (3, c) each, to the way from its closest point to p."""
    ab, ac, ap = b - a, c - a, p - a
    bb, bc, cc, pb, pc = dot(ab, ab), dot(ab, ac), dot(ac, ac), dot(ap, ab), dot(ap, ac)
    square = bb * cc - bc**2
    flat = square <= FLAT * bb * cc
    divisor = jnp.where(flat, 1.0, square)
    at_b, at_c = (cc * pb - bc * pc) / divisor, (bb * pc - bc * pb) / divisor
    inside = jnp.stack([1.0 - at_b - at_c, at_b, at_c])
    # Beside the triangle the closest of the closest points of its edges.
    tails = jnp.stack([a, b, c], axis=1)
    along, to_p = jnp.roll(tails, -1, axis=1) - tails, p[:, None] - tails
    t = jnp.clip(dot(to_p, along) / jnp.maximum(dot(along, along), TINY), 0.0, 1.0)
    away = to_p - t * along
    closest = jnp.arange(3)[:, None] == jnp.argmin(dot(away, away), axis=0)
    on_edge = jnp.where(closest, 1.0 - t, 0.0) + jnp.roll(jnp.where(closest, t, 0.0), 1, axis=0)
    over = ~flat & jnp.all(inside >= 0.0, axis=0)
    return jnp.concatenate([jnp.ones_like(t[:1]), -jnp.where(over, inside, on_edge)])


def edge_edge_weights(a: Array, b: Array, c: Array, d: Array) -> Array:
    """The same for the segments ab and cd (Ericson, Real-Time Collision Detection, 5.1.9)."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv, uw, vw = dot(u, u), dot(u, v), dot(v, v), dot(u, w), dot(v, w)
    square = jnp.maximum(uu * vv - uv**2, FLAT * uu * vv + TINY)
    s = jnp.clip((uv * vw - vv * uw) / square, 0.0, 1.0)
    t = jnp.clip((uv * s + vw) / jnp.maximum(vv, TINY), 0.0, 1.0)
    s = jnp.clip((uv * t - uw) / jnp.maximum(uu, TINY), 0.0, 1.0)
    return jnp.stack([1.0 - s, s, t - 1.0, -t])
