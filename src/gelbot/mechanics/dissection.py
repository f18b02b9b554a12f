"""Nested dissection: in which order a body's nodes are eliminated, so that its stiffness has a small factor.

A body is cut in two by a thin layer of nodes, its parts are cut again, and so on (George 1973). Parts on either side of
a cut do not know each other: their stiffness is inverted part by part, and what they do to the cuts is added up there.
The uppermost cuts are taken together as one front, whose inverse is dense; a small body is that front and nothing else.
All of this is done once for a body. It gives tables of where to find what, so that the numbers (`multifrontal`) are
gathers and products of equal, small matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
from jax import Array
from numpy.typing import NDArray

Ints = NDArray[np.int64]

PART_MOST = 24
"""Parts are not cut further once they have no more nodes than this."""
DEEPEST = 12
"""Cuts of cuts, at most."""
LEVEL_COST = 6e3
"""What a level of the tree costs beside its numbers, counted in numbers read."""
SAMPLES = 8
"""Directions tried for a cut."""


class Level(NamedTuple):
    """`B` fronts that are eliminated together, each with `s` nodes to eliminate and a border of `t` nodes that stay.

    `pivots` (B, s): nodes, or the node count where a front has fewer. `columns` (B, s + t, s, k): where to find the
    3 x 3 blocks whose sum each block of the front's matrix in the columns of its pivots is, in the matrix's blocks
    followed by what the level below leaves; `rest` (B, t, t, k): the same for its border, to which only they add.
    `inputs` (B, s + t, k): where to find, in what the levels below leave to their borders, the forces to add.
    `outputs` (B, t): where the border's nodes stand in the solution, the levels above first.
    """

    pivots: Array
    columns: Array
    rest: Array
    inputs: Array
    outputs: Array


class Dissection(NamedTuple):
    """The tree, `levels` from the parts up to the last front; `order` (n,): where each node stands in the solution.

    Blocks of the matrix are numbered: 0 is zero, then the `n` of the diagonal, then those of the pairs (i, j) as they
    were given, then their transposes.
    """

    levels: tuple[Level, ...]
    order: Array


class Front(NamedTuple):
    """A front of the tree: the nodes it eliminates, the later nodes that they touch, its children's numbers."""

    pivots: Ints
    border: Ints
    children: tuple[int, ...]
    depth: int


def dissect(points: NDArray[np.float64], pairs: Ints) -> Dissection:
    """Order the nodes at `points` [m], shape (3, n), of which `pairs`, shape (2, c), touch each other.

    The tree is as deep, and as many cuts are taken together, as makes the inverse cheapest to apply.
    """
    n = points.shape[1]
    graph = _graph(n, pairs)
    best: tuple[float, list[Front]] | None = None
    cuts: list[list[Ints]] = []
    parts = [np.arange(n)]
    for depth in range(DEEPEST + 1):
        if depth > 0:
            if n < PART_MOST * 2 ** (depth - 1):
                break
            level, parts = _cut(points, graph, parts)
            cuts.append(level)
        for merged in range(1, depth + 1) if depth else (0,):
            fronts = _fronts([*cuts, parts], graph, depth, merged)
            cost = _cost(fronts)
            if best is None or cost < best[0]:
                best = cost, fronts
    assert best is not None  # depth 0 always counts
    return _tables(best[1], n, pairs)


def _graph(n: int, pairs: Ints) -> scipy.sparse.csr_matrix:
    ones = np.ones(pairs.shape[1], dtype=np.int8)
    half = scipy.sparse.coo_matrix((ones, (pairs[0], pairs[1])), shape=(n, n))
    return (half + half.T).tocsr()


def _cut(
    points: NDArray[np.float64], graph: scipy.sparse.csr_matrix, parts: list[Ints]
) -> tuple[list[Ints], list[Ints]]:
    """A cut through each of `parts`, and their halves, two of each."""
    cuts, halves = [], []
    for part in parts:
        first, cut, second = _bisect(points, graph, part)
        cuts.append(cut)
        halves += [first, second]
    return cuts, halves


def _bisect(points: NDArray[np.float64], graph: scipy.sparse.csr_matrix, part: Ints) -> tuple[Ints, Ints, Ints]:
    """Two halves of `part` and the smallest cut between them, of those across `SAMPLES` directions in its plane."""
    if len(part) < 2:
        return part, part[:0], part[:0]
    local = points[:, part] - points[:, part].mean(axis=1, keepdims=True)
    axes = np.linalg.svd(local, full_matrices=False)[0]
    best: tuple[float, tuple[Ints, Ints, Ints]] | None = None
    inner = graph[part][:, part]
    for angle in np.pi * np.arange(SAMPLES) / SAMPLES:
        height = (np.cos(angle) * axes[:, 0] + np.sin(angle) * axes[:, 1]) @ local
        # Rounded: a mesh of equal columns has many nodes at one height, which stay together.
        lower = height <= np.round(np.median(height), 12) + 1e-12
        if lower.all():
            continue
        between = inner[np.flatnonzero(lower)][:, np.flatnonzero(~lower)]
        # A node covers the pairs that it is in, no more: what is sure to be wider than the best is not searched, along
        # a narrow part above all, where the search takes minutes.
        most = max([1, *(int(np.bincount(ends).max()) for ends in between.nonzero() if len(ends))])
        if best is not None and between.nnz / most >= best[0]:
            continue
        cut = _vertex_cover(between, lower)
        first, second = np.setdiff1d(part[lower], part[cut]), np.setdiff1d(part[~lower], part[cut])
        uneven = abs(len(first) - len(second)) / len(part)
        cost = len(cut) * (1.0 + uneven)
        if best is None or cost < best[0]:
            best = cost, (first, part[cut], second)
    return best[1] if best is not None else (part, part[:0], part[:0])


def _vertex_cover(between: scipy.sparse.csr_matrix, lower: NDArray[np.bool_]) -> Ints:
    """The fewest nodes that touch all pairs `between` those that are `lower` and the rest (Koenig's theorem)."""
    first, second = np.flatnonzero(lower), np.flatnonzero(~lower)
    match = scipy.sparse.csgraph.maximum_bipartite_matching(between, perm_type="column")
    # From the unmatched nodes of the first side, along alternating paths.
    back = np.full(len(second), -1)
    matched = np.flatnonzero(match >= 0)
    back[match[matched]] = matched
    reached_first = match < 0
    reached_second = np.zeros(len(second), dtype=bool)
    fresh = np.flatnonzero(reached_first)
    while len(fresh):
        found = np.unique(between[fresh].indices)
        found = found[~reached_second[found]]
        reached_second[found] = True
        fresh = back[found]
        fresh = fresh[(fresh >= 0) & ~reached_first[fresh]]
        reached_first[fresh] = True
    return np.concatenate([first[~reached_first], second[reached_second]])


def _fronts(sets: list[list[Ints]], graph: scipy.sparse.csr_matrix, depth: int, merged: int) -> list[Front]:
    """Fronts from the parts up; the cuts of the first `merged` depths are the last front."""
    fronts: list[Front] = []
    place = np.zeros(graph.shape[0], dtype=np.int64)  # at which depth a node is eliminated
    top = np.concatenate([cut for cuts in sets[:merged] for cut in cuts]) if merged else sets[0][0]
    for d in range(merged, depth + 1):
        for pivots in sets[d]:
            place[pivots] = d
    place[top] = -1
    below: list[int] = []
    for d in range(depth, merged - 1, -1) if merged else ():
        numbers = []
        for k, pivots in enumerate(sets[d]):
            children = (below[2 * k], below[2 * k + 1]) if d < depth else ()
            touched = [graph[pivots].indices, *(fronts[child].border for child in children)]
            border = np.unique(np.concatenate(touched))
            border = np.setdiff1d(border[place[border] < d], pivots)
            numbers.append(len(fronts))
            fronts.append(Front(np.sort(pivots), border, children, d))
        below = numbers
    fronts.append(Front(np.sort(top), top[:0], tuple(below), -1))
    return fronts


def _cost(fronts: Sequence[Front]) -> float:
    """Numbers read when the inverse is applied, padding and levels included."""
    total = 0.0
    for depth in {front.depth for front in fronts}:
        level = [front for front in fronts if front.depth == depth]
        s, t = (max(len(part) for part in parts) for parts in zip(*(f[:2] for f in level), strict=True))
        total += 9.0 * len(level) * s * (s + 2 * t) + LEVEL_COST
    return total


def _tables(fronts: list[Front], n: int, pairs: Ints) -> Dissection:
    count = pairs.shape[1]
    block = scipy.sparse.coo_matrix(
        (
            np.arange(1, n + 2 * count + 1),
            (
                np.concatenate([np.arange(n), pairs[0], pairs[1]]),
                np.concatenate([np.arange(n), pairs[1], pairs[0]]),
            ),
        ),
        shape=(n, n),
    ).tocsr()
    depths = sorted({front.depth for front in fronts}, reverse=True)
    groups = [[k for k, front in enumerate(fronts) if front.depth == depth] for depth in depths]
    sizes = [tuple(max(len(part) for part in parts) for parts in zip(*(fronts[k][:2] for k in g), strict=True))
             for g in groups]  # fmt: skip
    # Where a front's blocks and border begin in what the levels below leave.
    blocks_at, border_at = {}, {}
    next_border = 1
    for group, (_, t) in zip(groups, sizes, strict=True):
        for row, k in enumerate(group):
            # Only the level above asks for them: its fronts' children are all in this one.
            blocks_at[k], border_at[k] = n + 2 * count + 1 + row * t * t, next_border
            next_border += t
    # The solution holds the levels from the last front down.
    order = np.zeros(n, dtype=np.int64)
    start = 0
    for group, (s, _) in zip(groups[::-1], sizes[::-1], strict=True):
        for row, k in enumerate(group):
            order[fronts[k].pivots] = start + row * s + np.arange(len(fronts[k].pivots))
        start += len(group) * s
    levels = []
    for group, (s, t) in zip(groups, sizes, strict=True):
        pivots = np.full((len(group), s), n)
        outputs = np.zeros((len(group), t), dtype=np.int64)
        entries: list[tuple[Ints, Ints]] = []
        rests: list[tuple[Ints, Ints]] = []
        inputs: list[tuple[Ints, Ints]] = []
        size = s + t
        for row, k in enumerate(group):
            front = fronts[k]
            pivots[row, : len(front.pivots)] = front.pivots
            outputs[row, : len(front.border)] = order[front.border]
            nodes = np.concatenate([front.pivots, front.border])
            where = np.concatenate([np.arange(len(front.pivots)), s + np.arange(len(front.border))])
            position = dict(zip(nodes.tolist(), where.tolist(), strict=True))
            own = block[nodes][:, front.pivots].tocoo()
            entries.append((row * size * s + where[own.row] * s + where[own.col], own.data.astype(np.int64)))
            for child in front.children:
                border = fronts[child].border
                wide = _width(child, groups, sizes)
                at = np.array([position[node] for node in border.tolist()], dtype=np.int64)
                own_place = np.arange(len(border))
                i, j = (part.ravel() for part in np.meshgrid(at, at, indexing="ij"))
                source = (blocks_at[child] + own_place[:, None] * wide + own_place[None, :]).ravel()
                entries.append(((row * size * s + i * s + j)[j < s], source[j < s]))
                kept = (i >= s) & (j >= s)
                rests.append(((row * t * t + (i - s) * t + (j - s))[kept], source[kept]))
                inputs.append((row * size + at, border_at[child] + own_place))
        levels.append(
            Level(
                pivots=jnp.asarray(pivots, jnp.int32),
                columns=_table(entries, (len(group), size, s)),
                rest=_table(rests, (len(group), t, t)),
                inputs=_table(inputs, (len(group), size)),
                outputs=jnp.asarray(outputs, jnp.int32),
            )
        )
    return Dissection(tuple(levels), jnp.asarray(order, jnp.int32))


def _width(front: int, groups: list[list[int]], sizes: Sequence[tuple[int, ...]]) -> int:
    """The padded border of a front."""
    return next(t for group, (_, t) in zip(groups, sizes, strict=True) if front in group)


def _table(found: list[tuple[Ints, Ints]], shape: tuple[int, ...]) -> Array:
    """Places and what goes there, as a table with as many columns as the fullest place needs; 0 where nothing is."""
    if not found:
        return jnp.zeros((*shape, 0), jnp.int32)
    places, sources = (np.concatenate(parts) for parts in zip(*found, strict=True))
    ranked = np.argsort(places, kind="stable")
    places, sources = places[ranked], sources[ranked]
    counts = np.bincount(places, minlength=int(np.prod(shape)))
    rank = np.arange(len(places)) - np.repeat(np.cumsum(counts) - counts, counts)
    table = np.zeros((int(np.prod(shape)), int(counts.max(initial=0))), dtype=np.int32)
    table[places, rank] = sources
    return jnp.asarray(table.reshape(*shape, table.shape[1]), jnp.int32)
