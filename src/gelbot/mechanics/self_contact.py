"""Where the body meets itself: gaps between its surface nodes and faces, and between the sharp edges of its rim.

Each contact is one number, the gap between two points of the surface, weighted means of up to four nodes:

    gap = n . sum_k w_k x_k,    d gap / d x_k = w_k n,

with weights that sum to 1 on the first side and to -1 on the second, n pointing from the second to the first: what the
weights and the normal change by does not count, since the points are the closest ones (envelope theorem). Energies are
sums of share * phi(gap).

`find_pairs` looks for what is near, seldom; `settle` decides once a step which of it counts, by how much (`share`) and
with which sign; `pair_gaps` is smooth and follows the nodes within the step. `settle` gives each node one whole contact
for each surface it meets: the face it stands over; none but the closest edge or corner, signed by its pseudonormal
(Baerentzen and Aanaes 2005), where it stands over no face; shares of the faces of a crease where it stands over
several, so that all of them push. So it does not matter how finely the other side is meshed.
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

FAR = 1.0
"""Gap [m] of what does not touch."""
PATCH = 8
"""Faces, nodes or edges in a patch."""
SHARP = np.radians(30.0)
"""Angle at rest between the faces of an edge above which it is sharp."""
EXCLUSION = 1.5
"""Parts closer at rest than this, times thickness + mesh size, cannot meet."""
CREASE = 3.0
"""A second face pushes too while it is less than this many layers farther away than the first."""
ALIGNED = 0.5
"""Least cosine between the way out through an edge or corner and its pseudonormal."""
PARALLEL, CROSSED = 0.05, 0.10
"""Sines of the angle between two edges: not a contact, a whole one."""
TINY = 1e-30
"""Keeps what is divided by a squared length [m^2] finite."""


class ContactSurface(NamedTuple):
    """Constants of a closed triangulated surface; index letters n nodes, f faces, e sharp convex edges, c candidates.

    `rest` [m] (3, n); `faces` (3, f), `face_neighbours` (3, f): the faces beyond their edges 0-1, 1-2, 2-0;
    `node_corners` (d, n): places in `faces.ravel()` where a node occurs, padded with 3 f; `edges` (2, e), running
    counter-clockwise round the first of their faces `edge_faces` (2, e). Patches (m, p), padded with -1, of surface
    nodes, faces and edges; `node_face_patches`, `edge_edge_patches`: patches that may meet, (p, p). Places for patch
    pairs, near pairs and contacts, `*_places`, are 0, 1, 2, ...: their lengths are the capacities.
    """

    rest: Array
    faces: Array
    face_neighbours: Array
    node_corners: Array
    edges: Array
    edge_faces: Array
    node_patches: Array
    face_patches: Array
    edge_patches: Array
    node_face_patches: Array
    edge_edge_patches: Array
    exclusion: Array
    half_thickness: Array
    layer: Array
    margin: Array
    node_face_places: tuple[Array, Array, Array]
    edge_edge_places: tuple[Array, Array, Array]


class ContactPairs(NamedTuple):
    """Candidates, c of them: those of a node and a face first, then those of two edges.

    `nodes` (4, c): a node and the corners of a face, or the ends of two edges; `things` (2, c): numbers of node and
    face, or of both edges; `valid` (c,). What `settle` decides, (c,): `share` in [0, 1] of a contact; `side`: the sign
    of a distance from an edge or a corner, of the cross product of two edges; `over`: the node stands over the face.
    `count` candidates were found, `missed` more (or pairs of patches) found no place. `depth` [m]: as far behind a
    surface contact is possible. `local` [m] (3, n): where the nodes were, seen from the body.
    """

    nodes: Array
    things: Array
    valid: Array
    share: Array
    side: Array
    over: Array
    count: Array
    missed: Array
    depth: Array
    local: Array


class PairGaps(NamedTuple):
    """`gap` [m] (c,), `weights` (4, c) of the pairs' nodes, unit `normal` (3, c) from the second side to the first."""

    gap: Array
    weights: Array
    normal: Array


def contact_surface(
    faces: NDArray[np.int64],
    rest: NDArray[np.float64],
    thickness: float,
    mesh_size: float,
    layer: float,
    margin: float,
    contacts_per_node: float = 2.0,
) -> ContactSurface:
    """Prepare a closed surface of `faces` (3, f), outward by the right-hand rule, at `rest` [m] (3, n).

    `layer` [m] is the gap at which contact begins, `margin` [m] how much farther candidates are looked for. There is
    room for `contacts_per_node` candidates for each surface node and for each sharp edge.
    """
    exclusion = EXCLUSION * (thickness + mesh_size)
    surface_nodes = np.unique(faces)
    neighbours, edges, edge_faces = _adjacency(faces, rest)
    order = np.argsort(faces.ravel(), kind="stable")
    degree = np.bincount(faces.ravel(), minlength=rest.shape[1])
    corners = np.full((int(degree.max()), rest.shape[1]), faces.size)
    place = np.arange(faces.size) - np.repeat(np.cumsum(degree) - degree, degree)
    corners[place, faces.ravel()[order]] = order

    node_patches, node_balls = _patches(rest[:, surface_nodes], np.zeros(len(surface_nodes)))
    face_patches, face_balls = _patches(*_rest_balls(rest[:, faces]))
    edge_patches, edge_balls = _patches(*_rest_balls(rest[:, edges]))
    edge_edge = _may_meet(edge_balls, edge_balls, exclusion)
    node_room, edge_room = (int(np.ceil(contacts_per_node * m)) for m in (len(surface_nodes), edges.shape[1]))
    return ContactSurface(
        rest=jnp.asarray(rest),
        faces=jnp.asarray(faces),
        face_neighbours=jnp.asarray(neighbours),
        node_corners=jnp.asarray(corners),
        edges=jnp.asarray(edges),
        edge_faces=jnp.asarray(edge_faces),
        node_patches=jnp.asarray(np.where(node_patches < 0, -1, surface_nodes[node_patches])),
        face_patches=jnp.asarray(face_patches),
        edge_patches=jnp.asarray(edge_patches),
        node_face_patches=jnp.asarray(_may_meet(node_balls, face_balls, exclusion)),
        edge_edge_patches=jnp.asarray(np.triu(edge_edge)),
        exclusion=jnp.asarray(exclusion),
        half_thickness=jnp.asarray(0.5 * thickness),
        layer=jnp.asarray(layer),
        margin=jnp.asarray(margin),
        node_face_places=_places(node_room, node_patches.shape[1], face_patches.shape[1]),
        edge_edge_places=_places(edge_room, edge_patches.shape[1], edge_patches.shape[1]),
    )


def _places(room: int, first: int, second: int) -> tuple[Array, Array, Array]:
    return jnp.arange(min(first * second, 8 * max(first, second))), jnp.arange(2 * room), jnp.arange(room)


def _adjacency(
    faces: NDArray[np.int64], rest: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Neighbours of each face (3, f), sharp convex edges (2, e) and their faces (2, e), the first on their left."""
    count = faces.shape[1]
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=0).ravel()
    order = np.lexsort((np.maximum(tails, heads), np.minimum(tails, heads)))
    one, other = order[0::2], order[1::2]
    if len(one) != len(other) or np.any(tails[one] != heads[other]) or np.any(heads[one] != tails[other]):
        raise ValueError("the surface is not closed, or not all of its faces are turned the same way")
    neighbours = np.empty(3 * count, dtype=np.int64)
    neighbours[one], neighbours[other] = other % count, one % count
    a, b, c = (rest[:, faces[k]] for k in range(3))
    normal = np.cross(b - a, c - a, axis=0)
    normal /= np.linalg.norm(normal, axis=0)
    left, right = one % count, other % count
    along = rest[:, heads[one]] - rest[:, tails[one]]
    cosine = np.sum(normal[:, left] * normal[:, right], axis=0)
    convex = np.sum(np.cross(normal[:, left], normal[:, right], axis=0) * along, axis=0) > 0.0
    sharp = convex & (cosine < np.cos(SHARP))
    edges, edge_faces = np.stack([tails[one], heads[one]]), np.stack([left, right])
    return neighbours.reshape(3, count), edges[:, sharp], edge_faces[:, sharp]


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
            middle = (len(part) + 1) // 2
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
    """What lies within layer + margin in front, or half the thickness + margin behind; settled at `positions`.

    `positions` [m] (3, n[, b]); `frame` (3, 3[, b]) turns with the body, its columns are the body's axes.
    """
    in_front, behind = surface.layer + surface.margin, surface.half_thickness + surface.margin
    reach = jnp.maximum(in_front, behind)
    everywhere = jnp.broadcast_to(jnp.arange(positions.shape[1]), (1, positions.shape[1]))
    (node, face), near, lost = _near(
        surface, positions, reach, everywhere, surface.faces,
        surface.node_patches, surface.face_patches, surface.node_face_patches, surface.node_face_places,
    )  # fmt: skip
    corners = jnp.concatenate([node[None], surface.faces[:, face]])
    distance, height, *_ = _node_on_face(*positions[:, corners].swapaxes(0, 1))
    near = near & (distance < jnp.where(height < 0.0, behind, in_front))
    (corners, node, face), met, missed = _gathered(near, surface.node_face_places[2], (corners, node, face))

    (one, two), near, lost_edges = _near(
        surface, positions, reach, surface.edges, surface.edges,
        surface.edge_patches, surface.edge_patches, surface.edge_edge_patches, surface.edge_edge_places,
    )  # fmt: skip
    ends = jnp.concatenate([surface.edges[:, one], surface.edges[:, two]])
    near = near & (_edge_distance(*positions[:, ends].swapaxes(0, 1)) < reach)
    (ends, one, two), crossed, missed_edges = _gathered(near, surface.edge_edge_places[2], (ends, one, two))

    valid = jnp.concatenate([met, crossed])
    unknown = jnp.zeros(valid.shape, positions.dtype)
    pairs = ContactPairs(
        nodes=jnp.concatenate([corners, ends], axis=1),
        things=jnp.concatenate([jnp.stack([node, face]), jnp.stack([one, two])], axis=1),
        valid=valid,
        share=unknown,
        side=unknown,
        over=jnp.zeros(valid.shape, bool),
        count=jnp.sum(valid),
        missed=lost + missed + lost_edges + missed_edges,
        depth=surface.half_thickness.astype(positions.dtype),
        local=_seen_from_body(positions, frame),
    )
    return jax.lax.cond(pairs.count > 0, lambda p: settle(surface, p, positions), lambda p: p, pairs)


@_each_robot
def stale(surface: ContactSurface, pairs: ContactPairs, positions: Array, frame: Array) -> Array:
    """Whether some node has moved more than margin / 2, seen from the body, since `pairs` were found; shape () or (b,).

    Rigid motions change no distance: how well `frame` (3, 3[, b]) follows the body decides only how often to look.
    """
    moved = _seen_from_body(positions, frame) - pairs.local
    return jnp.max(jnp.sum(moved**2, axis=0)) > (0.5 * surface.margin) ** 2


def _seen_from_body(positions: Array, frame: Array) -> Array:
    return frame.T.astype(positions.dtype) @ (positions - jnp.mean(positions, axis=1, keepdims=True))


def _first_places(found: Array, places: Array) -> tuple[Array, Array, Array]:
    """Indices of the first true entries of `found`, one for each place; which places are taken; how many got none."""
    running = jnp.cumsum(found.ravel(), dtype=jnp.int32)
    index = jnp.searchsorted(running, places.astype(jnp.int32) + 1)
    index = jnp.minimum(index, running.shape[0] - 1)
    return index, places < running[-1], jnp.maximum(0, running[-1] - places.shape[0])


def _gathered(found: Array, places: Array, columns: tuple[Array, ...]) -> tuple[tuple[Array, ...], Array, Array]:
    if found.shape[0] == 0:
        return columns, found, jnp.zeros((), jnp.int32)
    index, taken, missed = _first_places(found, places)
    return tuple(column[..., index] for column in columns), taken, missed


def _near(
    surface: ContactSurface,
    positions: Array,
    reach: Array,
    first: Array,
    second: Array,
    first_patches: Array,
    second_patches: Array,
    may_meet: Array,
    places: tuple[Array, Array, Array],
) -> tuple[tuple[Array, Array], Array, Array]:
    """Pairs of simplices `first` (d, .) and `second` (d, .) whose balls come within `reach` and that are not excluded.

    Numbers of both, shape (c,), which of them are real, and how many got no place.
    """
    none = jnp.zeros(places[1].shape, jnp.int32)
    if may_meet.size == 0:
        return (none, none), none > 0, jnp.zeros((), jnp.int32)
    centre_1, radius_1 = _balls(positions, first)
    centre_2, radius_2 = _balls(positions, second)
    ball_1 = _patch_balls(centre_1, radius_1, first_patches)
    ball_2 = _patch_balls(centre_2, radius_2, second_patches)
    close = may_meet & (_squares(ball_1[0][:, :, None], ball_2[0][:, None]) < (ball_1[1][:, None] + ball_2[1] + reach) ** 2)
    index, taken, lost = _first_places(close, places[0])

    def look(_: None) -> tuple[tuple[Array, Array], Array, Array]:
        i, j = first_patches[:, index // may_meet.shape[1]], second_patches[:, index % may_meet.shape[1]]
        real = (taken & (i >= 0))[:, None] & (taken & (j >= 0))[None]
        square = _squares(centre_1[:, i][:, :, None], centre_2[:, j][:, None])
        rest_1, rest_2 = _balls(surface.rest, first)[0], _balls(surface.rest, second)[0]
        apart = _squares(rest_1[:, i][:, :, None], rest_2[:, j][:, None]) >= surface.exclusion**2
        near = real & apart & (square < (radius_1[i][:, None] + radius_2[j][None] + reach) ** 2)
        if first is second:
            near = near & ((index // may_meet.shape[1] != index % may_meet.shape[1]) | (i[:, None] < j[None]))
        place, found, missed = _first_places(near, places[1])
        both = [jnp.broadcast_to(k, near.shape).ravel()[place] for k in (i[:, None], j[None])]
        return (both[0].astype(jnp.int32), both[1].astype(jnp.int32)), found, lost + missed

    return jax.lax.cond(jnp.any(taken), look, lambda _: ((none, none), none > 0, jnp.zeros((), jnp.int32)), None)


def _balls(positions: Array, simplices: Array) -> tuple[Array, Array]:
    corners = positions[:, simplices]
    centre = jnp.mean(corners, axis=1)
    return centre, jnp.sqrt(jnp.max(_squares(corners, centre[:, None]), axis=0))


def _patch_balls(centre: Array, radius: Array, patches: Array) -> tuple[Array, Array]:
    members = jnp.where(patches < 0, patches[:1], patches)
    middle = jnp.mean(centre[:, members], axis=1)
    return middle, jnp.max(jnp.sqrt(_squares(centre[:, members], middle[:, None])) + radius[members], axis=0)


def _squares(a: Array, b: Array) -> Array:
    return jnp.sum((a - b) ** 2, axis=0)


@_each_robot
def settle(surface: ContactSurface, pairs: ContactPairs, x0: Array) -> ContactPairs:
    """Decide, for the nodes at `x0` [m] (3, n[, b]), which pairs are contacts, by how much and with which sign.

    To be called with the positions at the beginning of a step and kept until its end: within it gaps are smooth.
    """
    normals, corner_normals = _face_and_node_normals(surface, x0)
    met = surface.node_face_places[2].shape[0]
    node, face = pairs.things[:, :met]
    corners = pairs.nodes[:, :met]
    distance, _, weights, over, part = _node_on_face(*x0[:, corners].swapaxes(0, 1))
    # The pseudonormal of what is closest: the face, one of its edges, one of its corners.
    beyond = normals[:, surface.face_neighbours[:, face]] + normals[:, None, face]
    choices = jnp.concatenate([normals[:, None, face], beyond, corner_normals[:, corners[1:]]], axis=1)
    pseudonormal = jnp.take_along_axis(choices, part[None, None], axis=1)[:, 0]
    away = x0[:, node] - jnp.sum(weights * x0[:, corners[1:]], axis=1)
    height = jnp.sum(away * pseudonormal, axis=0)
    outside = height >= 0.0
    length = jnp.sqrt(jnp.sum(pseudonormal**2, axis=0))
    possible = outside | ((distance < pairs.depth) & (over | (-height > ALIGNED * length * distance)))
    share = _node_shares(2 * node + outside, distance, over, pairs.valid[:met] & possible, surface.layer, x0.shape[1])

    side, crossed = _edge_shares(surface, pairs, x0, normals)
    return pairs._replace(
        share=jnp.concatenate([share, crossed]),
        side=jnp.concatenate([jnp.where(outside, 1.0, -1.0).astype(x0.dtype), side]),
        over=pairs.over.at[:met].set(over),
    )


def _node_shares(group: Array, distance: Array, over: Array, possible: Array, layer: Array, count: Array) -> Array:
    """How much of one contact each pair is; `group` is 2 node + (outside the surface).

    Of what a node is outside of (or inside of) the closest counts; farther ones fade over CREASE layers.
    """
    least = jax.ops.segment_min(jnp.where(possible, distance, jnp.inf), group, 2 * count)[group]
    fade = jnp.clip(1.0 - (distance - least) / (CREASE * layer), 0.0, 1.0)
    tied = distance <= least * (1.0 + 1e-5) + 1e-4 * layer
    part = jnp.where(possible, jnp.where(over, fade, tied), 0.0)
    # Where the node crosses one face of a crease it changes the group: close to zero both groups are one.
    close = jnp.clip(1.0 - distance / (CREASE * layer), 0.0, 1.0)
    own = jax.ops.segment_sum(part, group, 2 * count)[group]
    other = close * jax.ops.segment_sum(part * close, group, 2 * count)[group ^ 1]
    return part / jnp.maximum(own + other, TINY)


def _edge_shares(surface: ContactSurface, pairs: ContactPairs, x0: Array, normals: Array) -> tuple[Array, Array]:
    """Sign of the cross product that points out of the second edge, and share, for pairs of edges.

    A contact when the shortest way between the lines lies within both edges and within the wedges of normals at both;
    it fades towards the wedge's sides, where a node and a face take over, and for parallel edges.
    """
    met = surface.node_face_places[2].shape[0]
    one, two = pairs.things[:, met:]
    a, b, c, d = x0[:, pairs.nodes[:, met:]].swapaxes(0, 1)
    s, t, across, sine = _common_perpendicular(a, b, c, d)
    left_1, right_1, left_2, right_2 = (normals[:, surface.edge_faces[k, e]] for e in (one, two) for k in (0, 1))
    side = jnp.where(jnp.sum(across * (left_2 + right_2), axis=0) < 0.0, -1.0, 1.0).astype(x0.dtype)
    normal = side * across
    gap = jnp.sum(normal * (a + s * (b - a) - c - t * (d - c)), axis=0)
    within = (s >= 0.0) & (s < 1.0) & (t >= 0.0) & (t < 1.0)
    wedge = _within_wedge(-normal, left_1, right_1, b - a) * _within_wedge(normal, left_2, right_2, d - c)
    share = wedge * jnp.clip((sine - PARALLEL) / (CROSSED - PARALLEL), 0.0, 1.0)
    return side, jnp.where(pairs.valid[met:] & within & (gap > -pairs.depth), share, 0.0)


def _within_wedge(normal: Array, left: Array, right: Array, along: Array) -> Array:
    """0 at the sides of the wedge between the normals of an edge's faces and beyond, 1 well within it."""
    axis = along / jnp.sqrt(jnp.sum(along**2, axis=0) + TINY)
    sines = [jnp.sum(jnp.cross(u, v, axis=0) * axis, axis=0) for u, v in ((left, normal), (normal, right))]
    half = 0.5 * jnp.sqrt(jnp.sum((left - right) ** 2, axis=0) + TINY)
    ahead = jnp.sum(normal * (left + right), axis=0) > 0.0
    return jnp.where(ahead, jnp.clip(4.0 * jnp.minimum(*sines) / half, 0.0, 1.0), 0.0)


def pair_gaps(pairs: ContactPairs, x: Array) -> PairGaps:
    """Gaps of settled `pairs` at `x` [m] (3, n[, b]); FAR, without weights, where there is no contact.

    Over a face the gap is the height over its plane, also beyond its edges; else it is the distance from the face's
    closest edge or corner, with the sign that it had when settled; for two edges that of their lines.
    """
    if x.ndim == 3:
        return jax.vmap(pair_gaps, in_axes=-1, out_axes=-1)(pairs, x)
    raise NotImplementedError
