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

from gelbot.mechanics.batch import dot

PATCH = 8
"""Faces, nodes or edges in a patch."""
EXCLUSION = 1.0
"""Parts whose middles are closer at rest than this, times thickness + mesh size, are neighbours."""
TINY = 1e-30
"""Keeps what is divided by a squared length [m^2] finite."""


class ContactSurface(NamedTuple):
    """Constants of a closed triangulated surface; index letters n nodes, f faces, e edges, c candidates.

    `rest` [m] (3, n); `faces` (3, f), `edges` (2, e). Patches (PATCH, p), padded with -1, of surface nodes, faces and
    edges; `node_face_patches`, `edge_edge_patches`: patches that may meet, (p, p). Lengths [m]: parts nearer than
    `exclusion` at rest are neighbours; contact begins at a distance of `layer`; candidates are looked for `margin`
    farther. Places for patch pairs, near pairs and candidates, `*_places`, are 0, 1, 2, ...: their lengths are the
    capacities.
    """

    rest: Array
    faces: Array
    edges: Array
    node_patches: Array
    face_patches: Array
    edge_patches: Array
    node_face_patches: Array
    edge_edge_patches: Array
    exclusion: Array
    layer: Array
    margin: Array
    node_face_places: tuple[Array, Array, Array]
    edge_edge_places: tuple[Array, Array, Array]


class ContactPairs(NamedTuple):
    """Candidates: `node_face` (4, c'), a node and the corners of a face; `edge_edge` (4, c"), the ends of two edges.

    `valid` (c' + c",): which places are taken; `found` of them are, `missed` more (or pairs of patches) got no place.
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
    contacts_per_node: float = 1.5,
) -> ContactSurface:
    """Prepare a closed surface of `faces` (3, f) at `rest` [m] (3, n).

    There is room for `contacts_per_node` candidates for each surface node and for each edge.
    """
    exclusion = EXCLUSION * (thickness + mesh_size)
    surface_nodes, edges = np.unique(faces), _edges(faces)
    node_patches, node_balls = _patches(rest[:, surface_nodes], np.zeros(len(surface_nodes)))
    face_patches, face_balls = _patches(*_rest_balls(rest[:, faces]))
    edge_patches, edge_balls = _patches(*_rest_balls(rest[:, edges]))
    node_room, edge_room = (int(np.ceil(contacts_per_node * m)) for m in (len(surface_nodes), edges.shape[1]))
    return ContactSurface(
        rest=jnp.asarray(rest),
        faces=jnp.asarray(faces),
        edges=jnp.asarray(edges),
        node_patches=jnp.asarray(np.where(node_patches < 0, -1, surface_nodes[node_patches])),
        face_patches=jnp.asarray(face_patches),
        edge_patches=jnp.asarray(edge_patches),
        node_face_patches=jnp.asarray(_may_meet(node_balls, face_balls, exclusion)),
        edge_edge_patches=jnp.asarray(np.triu(_may_meet(edge_balls, edge_balls, exclusion))),
        exclusion=jnp.asarray(exclusion),
        layer=jnp.asarray(layer),
        margin=jnp.asarray(margin),
        node_face_places=_places(node_room, node_patches.shape[1], face_patches.shape[1]),
        edge_edge_places=_places(edge_room, edge_patches.shape[1], edge_patches.shape[1]),
    )


def _places(room: int, first: int, second: int) -> tuple[Array, Array, Array]:
    return jnp.arange(min(first * second, 32 * max(first, second))), jnp.arange(8 * room), jnp.arange(room)


def _edges(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """The edges (2, e) of a closed surface."""
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=0).ravel()
    edges, times = np.unique(np.sort([tails, heads], axis=0), axis=1, return_counts=True)
    if np.any(times != 2) or len(np.unique(np.stack([tails, heads]), axis=1).T) != len(tails):
        raise ValueError("the surface is not closed, or not all of its faces are turned the same way")
    return edges


def _rest_balls(corners: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    centre = corners.mean(axis=1)
    return centre, np.linalg.norm(corners - centre[:, None], axis=0).max(axis=0, initial=0.0)


def _patches(
    points: NDArray[np.float64], radii: NDArray[np.float64]
) -> tuple[NDArray[np.int64], tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Cut `points` (3, m) in halves across their longest extent: patches (PATCH, p), and balls around their points."""
    parts = [np.arange(points.shape[1])]
    while max(len(part) for part in parts) > PATCH:
        halves = []
        for part in parts:
            if len(part) <= PATCH:
                halves.append(part)
                continue
            widest = int(np.argmax(np.ptp(points[:, part], axis=1)))
            middle = PATCH * ((-(-len(part) // PATCH) + 1) // 2)  # all patches but the last are full
            order = part[np.argsort(points[widest, part], kind="stable")]
            halves += [order[:middle], order[middle:]]
        parts = halves
    table = np.full((PATCH, len(parts)), -1)
    for p, part in enumerate(parts):
        table[: len(part), p] = part
    filled = np.where(table < 0, table[:1], table)
    centre = points[:, filled].mean(axis=1)
    return table, (centre, np.linalg.norm(points[:, filled] - centre[:, None], axis=0).max(axis=0, initial=0.0))


def _may_meet(
    first: tuple[NDArray[np.float64], NDArray[np.float64]],
    second: tuple[NDArray[np.float64], NDArray[np.float64]],
    exclusion: float,
) -> NDArray[np.bool_]:
    square = sum(np.subtract.outer(first[0][k], second[0][k]) ** 2 for k in range(3))
    return np.sqrt(square) + np.add.outer(first[1], second[1]) >= exclusion


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
    everywhere = jnp.arange(positions.shape[1])[None]
    node_face, met, missed = _near(
        surface, positions, everywhere, surface.faces,
        surface.node_patches, surface.face_patches, surface.node_face_patches, surface.node_face_places,
    )  # fmt: skip
    edge_edge, crossed, missed_edges = _near(
        surface, positions, surface.edges, surface.edges,
        surface.edge_patches, surface.edge_patches, surface.edge_edge_patches, surface.edge_edge_places,
    )  # fmt: skip
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


def _first_places(found: Array, places: Array) -> tuple[Array, Array, Array]:
    """Indices of the first true entries of `found`, one for each place; which places are taken; how many got none."""
    # Running sums are slow: they are taken over words of 32 bits, and the bits in a word found by halving it.
    size = found.size
    bits = jnp.pad(found.ravel(), (0, -size % 32)).reshape(-1, 32)
    words = jnp.sum(jnp.where(bits, jnp.uint32(1) << jnp.arange(32, dtype=jnp.uint32), 0), axis=1, dtype=jnp.uint32)
    running = jnp.cumsum(jax.lax.population_count(words).astype(jnp.int32))
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


def _near(
    surface: ContactSurface,
    positions: Array,
    first: Array,
    second: Array,
    first_patches: Array,
    second_patches: Array,
    may_meet: Array,
    places: tuple[Array, Array, Array],
) -> tuple[Array, Array, Array]:
    """Pairs of simplices `first` (d, .) and `second` (4 - d, .) nearer than layer + margin that are no neighbours.

    Nodes of both (4, c), which of them are real (c,), and how many got no place.
    """
    reach = surface.layer + surface.margin
    centre_1, radius_1 = _balls(positions, first)
    centre_2, radius_2 = _balls(positions, second)
    ball_1 = _patch_balls(centre_1, radius_1, first_patches)
    ball_2 = _patch_balls(centre_2, radius_2, second_patches)
    close = may_meet & (
        _squares(ball_1[0][:, :, None], ball_2[0][:, None]) < (ball_1[1][:, None] + ball_2[1] + reach) ** 2
    )
    index, taken, lost = _first_places(close, places[0])
    i, j = first_patches[:, index // may_meet.shape[1]], second_patches[:, index % may_meet.shape[1]]
    rest_1, rest_2 = _balls(surface.rest, first)[0], _balls(surface.rest, second)[0]
    # Gathered once, before all pairs of a patch pair are formed: fused, each pair would gather its own.
    one, other = jax.lax.optimization_barrier(
        (
            (centre_1[:, i], rest_1[:, i], jnp.where(taken & (i >= 0), radius_1[i] + reach, -jnp.inf)),
            (centre_2[:, j], rest_2[:, j], jnp.where(taken & (j >= 0), radius_2[j], -jnp.inf)),
        )
    )
    within = jnp.maximum(one[2][:, None] + other[2], 0.0)
    near = _squares(one[0][:, :, None], other[0][:, None]) < within**2
    near = near & (_squares(one[1][:, :, None], other[1][:, None]) >= surface.exclusion**2)
    if first is second:
        near = near & ((index // may_meet.shape[1] != index % may_meet.shape[1]) | (i[:, None] < j[None]))
    place, taken, crowded = _first_places(near, places[1])
    one, other = (jnp.broadcast_to(k, near.shape).ravel()[place] for k in (i[:, None], j[None]))
    nodes = jnp.concatenate([first[:, one], second[:, other]])
    away = jnp.sum(closest_weights(positions[:, nodes], first.shape[0]) * positions[:, nodes], axis=1)
    place, found, missed = _first_places(taken & (dot(away, away) < reach**2), places[2])
    return nodes[:, place], found, lost + crowded + missed


def _balls(positions: Array, simplices: Array) -> tuple[Array, Array]:
    corners = positions[:, simplices]
    centre = jnp.mean(corners, axis=1)
    return centre, jnp.sqrt(jnp.max(_squares(corners, centre[:, None]), axis=0))


def _patch_balls(centre: Array, radius: Array, patches: Array) -> tuple[Array, Array]:
    members = jnp.where(patches < 0, patches[:1], patches)
    middle = jnp.mean(centre[:, members], axis=1)
    return middle, jnp.max(jnp.sqrt(_squares(centre[:, members], middle[:, None])) + radius[members], axis=0)


def _squares(a: Array, b: Array) -> Array:
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2


def closest_weights(corners: Array, first: int) -> Array:
    """Signed weights (4, c) of the closest points of pairs at `corners` [m] (3, 4, c), `first` on the first side."""
    y = corners.swapaxes(0, 1)
    return node_face_weights(*y) if first == 1 else edge_edge_weights(*y)


def node_face_weights(p: Array, a: Array, b: Array, c: Array) -> Array:
    """Weights (4, c) that take p and the corners of a triangle, (3, c) each, to the way from its closest point to p."""
    ab, ac, ap = b - a, c - a, p - a
    across = jnp.cross(ab, ac, axis=0)
    square = dot(across, across)
    divisor = jnp.where(square > 0.0, square, 1.0)
    at_b, at_c = (dot(jnp.cross(*sides, axis=0), across) / divisor for sides in ((ap, ac), (ab, ap)))
    over = (square > 0.0) & (at_b >= 0.0) & (at_c >= 0.0) & (at_b + at_c <= 1.0)
    # Beside the triangle the closest of the points of its edges.
    best, corners, on_edge = jnp.inf, (a, b, c), [jnp.zeros_like(square)] * 3
    for k in range(3):
        tail, along = corners[k], corners[(k + 1) % 3] - corners[k]
        t = jnp.clip(dot(p - tail, along) / jnp.maximum(dot(along, along), TINY), 0.0, 1.0)
        away = p - tail - t * along
        closer = dot(away, away) < best
        best = jnp.where(closer, dot(away, away), best)
        shares: list[Any] = [0.0, 0.0, 0.0]
        shares[k], shares[(k + 1) % 3] = 1.0 - t, t
        on_edge = [jnp.where(closer, new, old) for new, old in zip(shares, on_edge, strict=True)]
    inside = (1.0 - at_b - at_c, at_b, at_c)
    shares = [jnp.where(over, new, old) for new, old in zip(inside, on_edge, strict=True)]
    return jnp.stack([jnp.ones_like(square), *(-share for share in shares)])


def edge_edge_weights(a: Array, b: Array, c: Array, d: Array) -> Array:
    """The same for the segments ab and cd (Ericson, Real-Time Collision Detection, 5.1.9)."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv, uw, vw = dot(u, u), dot(u, v), dot(v, v), dot(u, w), dot(v, w)
    across = jnp.cross(u, v, axis=0)
    square = jnp.maximum(dot(across, across), 1e-9 * uu * vv + TINY)
    s = jnp.clip((uv * vw - vv * uw) / square, 0.0, 1.0)
    t = jnp.clip((uv * s + vw) / jnp.maximum(vv, TINY), 0.0, 1.0)
    s = jnp.clip((uv * t - uw) / jnp.maximum(uu, TINY), 0.0, 1.0)
    return jnp.stack([1.0 - s, s, t - 1.0, -t])
