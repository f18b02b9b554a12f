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

from gelbot.mechanics.batch import dot

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
PARALLEL, CROSSED = 0.05, 0.10
"""Sines of the angle between two edges: not a contact, a whole one."""
ROUNDING = 1e-6
"""Share of an edge by which two edges may miss each other: two that follow each other leave no hole between them."""
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
    face, or of both edges; `valid` (c,). What `settle` decides: the `share` of a contact, in [0, 1], and the `side`,
    the sign of a distance from an edge or a corner or of the cross product of two edges, (c,); for nodes and faces
    only, whether a node stands `over` its face. `found` candidates are there, `missed` more (or pairs of patches) got
    no place. `depth` [m]: as far behind a surface contact is possible. `local` [m] (3, n): where the nodes were, seen
    from the body.
    """

    nodes: Array
    things: Array
    valid: Array
    share: Array
    side: Array
    over: Array
    found: Array
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
    contacts_per_node: float = 3.0,
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
    return jnp.arange(min(first * second, 16 * max(first, second))), jnp.arange(4 * room), jnp.arange(room)


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
    """What lies within layer + margin in front, or half the thickness + margin behind; not yet settled.

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
    return ContactPairs(
        nodes=jnp.concatenate([corners, ends], axis=1),
        things=jnp.concatenate([jnp.stack([node, face]), jnp.stack([one, two])], axis=1),
        valid=valid,
        share=unknown,
        side=unknown,
        over=jnp.zeros(met.shape, bool),
        found=jnp.sum(valid),
        missed=lost + missed + lost_edges + missed_edges,
        depth=surface.half_thickness.astype(positions.dtype),
        local=_seen_from_body(positions, frame),
    )


@_each_robot
def stale(surface: ContactSurface, pairs: ContactPairs, positions: Array, frame: Array) -> Array:
    """Whether some node has moved more than margin / 2, seen from the body, since `pairs` were found; shape () or (b,).

    Rigid motions change no distance: how well `frame` (3, 3[, b]) follows the body decides only how often to look.
    """
    moved = _seen_from_body(positions, frame) - pairs.local
    return jnp.max(dot(moved, moved)) > (0.5 * surface.margin) ** 2


def _seen_from_body(positions: Array, frame: Array) -> Array:
    return frame.T.astype(positions.dtype) @ (positions - jnp.mean(positions, axis=1, keepdims=True))


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
    close = may_meet & (
        _squares(ball_1[0][:, :, None], ball_2[0][:, None]) < (ball_1[1][:, None] + ball_2[1] + reach) ** 2
    )
    index, taken, lost = _first_places(close, places[0])

    def look(_: None) -> tuple[tuple[Array, Array], Array, Array]:
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
        place, found, missed = _first_places(near, places[1])
        both = [jnp.broadcast_to(jnp.maximum(k, 0), near.shape).ravel()[place] for k in (i[:, None], j[None])]
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
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2


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
    height = dot(away, pseudonormal)
    outside = height >= 0.0
    # Behind an edge or a corner lies mostly the same part of the body, bent: only over a face is a node known to be in.
    # And what came to lie deeper than two layers did not come from outside: the mesh is folded there.
    possible = outside | (over & (distance < 2.0 * surface.layer))
    share = _node_shares(2 * node + outside, distance, over, pairs.valid[:met] & possible, surface.layer, x0.shape[1])

    side, crossed = _edge_shares(surface, pairs, x0, normals)
    return pairs._replace(
        share=jnp.concatenate([share, crossed]),
        side=jnp.concatenate([jnp.where(outside, 1.0, -1.0).astype(x0.dtype), side]),
        over=over,
    )


def _node_shares(group: Array, distance: Array, over: Array, possible: Array, layer: Array, count: int) -> Array:
    """How much of one contact each pair is; `group` is 2 node + (outside the surface).

    Of what a node is outside of (or inside of) the closest counts; farther ones fade over CREASE layers. An edge or
    a corner counts only where nothing is closer; the sign of a pseudonormal means nothing elsewhere: a node over one
    face of the rim is behind the edges of the other.
    """
    shortest = jax.ops.segment_min(jnp.where(possible, distance, jnp.inf), group, 2 * count)
    least, opposite = shortest[group], shortest[group ^ 1]
    fade = jnp.clip(1.0 - (distance - least) / (CREASE * layer), 0.0, 1.0)
    closest = jnp.where(group % 2 == 1, least, jnp.minimum(least, opposite))
    tied = distance <= closest * (1.0 + 1e-5) + 1e-4 * layer
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
    side = jnp.where(dot(across, left_2 + right_2) < 0.0, -1.0, 1.0).astype(x0.dtype)
    normal = side * across
    gap = dot(normal, a - c)
    within = (s >= -ROUNDING) & (s <= 1.0 + ROUNDING) & (t >= -ROUNDING) & (t <= 1.0 + ROUNDING)
    wedge = _within_wedge(-normal, left_1, right_1, b - a) * _within_wedge(normal, left_2, right_2, d - c)
    share = wedge * jnp.clip((sine - PARALLEL) / (CROSSED - PARALLEL), 0.0, 1.0)
    return side, jnp.where(pairs.valid[met:] & within & (gap > -2.0 * surface.layer), share, 0.0)


def _within_wedge(normal: Array, left: Array, right: Array, along: Array) -> Array:
    """0 at the sides of the wedge between the normals of an edge's faces and beyond, 1 well within it."""
    axis = along / jnp.sqrt(dot(along, along) + TINY)
    sines = [dot(_cross(u, v), axis) for u, v in ((left, normal), (normal, right))]
    half = 0.5 * jnp.sqrt(_squares(left, right) + TINY)
    ahead = dot(normal, left + right) > 0.0
    return jnp.where(ahead, jnp.clip(4.0 * jnp.minimum(*sines) / half, 0.0, 1.0), 0.0)


def pair_gaps(pairs: ContactPairs, x: Array) -> PairGaps:
    """Gaps of settled `pairs` at `x` [m] (3, n[, b]); FAR, without weights, where there is no contact.

    Over a face the gap is the height over its plane, also beyond its edges; else it is the distance from the face's
    closest edge or corner, with the sign that it had when settled; for two edges that of their lines.
    """
    if x.ndim == 3:
        return jax.vmap(pair_gaps, in_axes=-1, out_axes=-1)(pairs, x)
    corners = x[:, pairs.nodes].swapaxes(0, 1)  # (4, 3, c)
    met = pairs.over.shape[0]
    faces = _node_face_gaps(corners[..., :met], pairs.side[:met], pairs.over[:met])
    edges = _edge_edge_gaps(corners[..., met:], pairs.side[met:])
    gap, weights, normal = (jnp.concatenate(both, axis=-1) for both in zip(faces, edges, strict=True))
    touching = pairs.valid & (pairs.share > 0.0) & (gap > -pairs.depth)
    return PairGaps(jnp.where(touching, gap, FAR), jnp.where(touching, weights, 0.0), normal)


def _node_face_gaps(corners: Array, side: Array, over: Array) -> PairGaps:
    p, a, b, c = corners
    distance, height, weights, over_now, _ = _node_on_face(p, a, b, c)
    flat, normal = _plane_coordinates(p, a, b, c)
    away = p - jnp.sum(weights[:, None] * corners[1:], axis=0)
    apart = distance > 0.0
    radial = jnp.where(apart, side * away / jnp.where(apart, distance, 1.0), normal)
    above = over | over_now
    shares = jnp.where(above, flat, weights)
    return PairGaps(
        gap=jnp.where(above, height, side * distance),
        weights=jnp.concatenate([jnp.ones_like(shares[:1]), -shares]),
        normal=jnp.where(above, normal, radial),
    )


def _edge_edge_gaps(corners: Array, side: Array) -> PairGaps:
    a, b, c, d = corners
    s, t, across, _ = _common_perpendicular(a, b, c, d)
    normal = side * across
    weights = jnp.stack([1.0 - s, s, t - 1.0, -t])
    return PairGaps(dot(normal, a - c), weights, normal)


def _plane_coordinates(p: Array, a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Barycentric coordinates (3, ...) of the foot of `p` in the plane of a triangle, and the plane's unit normal."""
    ab, ac, ap = b - a, c - a, p - a
    across = _cross(ab, ac)
    square = jnp.maximum(dot(across, across), TINY)
    at_b, at_c = dot(_cross(ap, ac), across) / square, dot(_cross(ab, ap), across) / square
    return jnp.stack([1.0 - at_b - at_c, at_b, at_c]), across / jnp.sqrt(square)


def _node_on_face(p: Array, a: Array, b: Array, c: Array) -> tuple[Array, Array, Array, Array, Array]:
    """The point of a triangle that is closest to `p`; all points (3, ...).

    Distance and height over the plane [m], the closest point's weights (3, ...), whether it lies in the face, and on
    which part: 0 the face, 1 - 3 the edges ab, bc, ca, 4 - 6 the corners.
    """
    flat, normal = _plane_coordinates(p, a, b, c)
    height = dot(normal, p - a)
    over = jnp.all(flat >= 0.0, axis=0)
    best = jnp.full(height.shape, jnp.inf, p.dtype)
    weights, part = jnp.zeros_like(flat), jnp.zeros(height.shape, jnp.int32)
    corners = (a, b, c)
    for k in range(3):
        tail, along = corners[k], corners[(k + 1) % 3] - corners[k]
        t = jnp.clip(dot(p - tail, along) / jnp.maximum(dot(along, along), TINY), 0.0, 1.0)
        rest = p - tail - t * along
        square = dot(rest, rest)
        closer = square < best
        on = [jnp.zeros_like(t)] * 3
        on[k], on[(k + 1) % 3] = 1.0 - t, t
        where = jnp.where(t <= 0.0, 4 + k, jnp.where(t >= 1.0, 4 + (k + 1) % 3, 1 + k))
        best, weights = jnp.where(closer, square, best), jnp.where(closer, jnp.stack(on), weights)
        part = jnp.where(closer, where, part)
    distance = jnp.where(over, jnp.abs(height), _length(best))
    return distance, height, jnp.where(over, flat, weights), over, jnp.where(over, 0, part)


def _common_perpendicular(a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array, Array, Array]:
    """Where the lines ab and cd are closest, as shares of their lengths; unit cross product; sine of their angle."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv, uw, vw = dot(u, u), dot(u, v), dot(v, v), dot(u, w), dot(v, w)
    both = uu * vv + TINY
    across = _cross(u, v)
    area = _length(dot(across, across))
    square = jnp.maximum(uu * vv - uv**2, 1e-4 * both)
    unit = across / jnp.where(area > 0.0, area, 1.0)
    return (uv * vw - vv * uw) / square, (uu * vw - uv * uw) / square, unit, area / jnp.sqrt(both)


def _edge_distance(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Distance [m] of the segments ab and cd (Ericson, Real-Time Collision Detection, 5.1.9)."""
    u, v, w = b - a, d - c, a - c
    s = jnp.clip(_common_perpendicular(a, b, c, d)[0], 0.0, 1.0)
    t = jnp.clip((dot(u, v) * s + dot(v, w)) / jnp.maximum(dot(v, v), TINY), 0.0, 1.0)
    s = jnp.clip((dot(u, v) * t - dot(u, w)) / jnp.maximum(dot(u, u), TINY), 0.0, 1.0)
    rest = w + s * u - t * v
    return _length(dot(rest, rest))


def _face_and_node_normals(surface: ContactSurface, x: Array) -> tuple[Array, Array]:
    """Unit normals of the faces (3, f), and of the nodes (3, n): means weighted with the angles of the faces there."""
    corners = x[:, surface.faces]
    towards, back = jnp.roll(corners, -1, axis=1) - corners, jnp.roll(corners, 1, axis=1) - corners
    across = _cross(towards, back)  # (3, 3, f): [component, corner, face]
    size = _length(dot(across, across))
    normals = across[:, 0] / jnp.where(size[0] > 0.0, size[0], 1.0)
    angle = jnp.arctan2(size, dot(towards, back))
    shares = jnp.concatenate([(normals[:, None] * angle).reshape(3, -1), jnp.zeros((3, 1), x.dtype)], axis=1)
    around = jnp.sum(shares[:, surface.node_corners], axis=1)
    size = _length(dot(around, around))
    return normals, around / jnp.where(size > 0.0, size, 1.0)


def _cross(a: Array, b: Array) -> Array:
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _length(square: Array) -> Array:
    """Square root with a slope of zero at zero."""
    return jnp.where(square > 0.0, jnp.sqrt(jnp.where(square > 0.0, square, 1.0)), 0.0)
