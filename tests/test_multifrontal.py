"""The stiffness inverted front by front, and the order in which its nodes are eliminated.

| identity | one road | the other |
|---|---|---|
| inverse | `factorise`, `solve`, any depth | numpy's, of a dense matrix written here |
| order | nodes eliminated by all fronts | each node, once |
| cut | pairs of nodes between two parts | none |
| a batch | mapped | one by one |
| depth | of a larger body | more levels |
| large body | its stiffness times the solution | the forces |
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse

from gelbot.body.lattice import Body, build_body
from gelbot.body.outline import strip
from gelbot.mechanics import dissection
from gelbot.mechanics.dissection import Dissection, dissect
from gelbot.mechanics.multifrontal import factorise, solve

MM = 1e-3
BODIES = ["starfish", "strip", "tiny"]


@pytest.fixture(scope="module")
def bodies(star) -> dict[str, Body]:
    return {
        "starfish": star,
        "strip": build_body(strip(24 * MM, 3 * MM), 1 * MM, 1 * MM),
        "tiny": build_body(strip(1 * MM, 1 * MM), 1 * MM, 1 * MM),
    }


def cut(body: Body, graph: scipy.sparse.csr_matrix, depth: int) -> list[list[np.ndarray]]:
    """The body cut `depth` times: the cuts of each time, and at last the parts."""
    levels, parts = [], [np.arange(body.nodes.shape[1])]
    for _ in range(depth):
        level, parts = dissection._cut(body.nodes, graph, parts)
        levels.append(level)
    return [*levels, parts]


def at_depth(body: Body, depth: int, merged: int) -> Dissection:
    """The body cut `depth` times, the cuts of the first `merged` of them taken together."""
    graph = dissection._graph(body.nodes.shape[1], body.springs)
    fronts = dissection._fronts(cut(body, graph, depth), graph, depth, merged)
    return dissection._tables(fronts, body.nodes.shape[1], body.springs)


def random_blocks(body: Body, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Blocks (n, 3, 3) and (c, 3, 3) of a symmetric positive definite matrix: dominated by its diagonal."""
    n, count = body.nodes.shape[1], body.springs.shape[1]
    between = rng.normal(size=(count, 3, 3))
    half = rng.normal(size=(n, 3, 3))
    most = np.zeros(n)
    for ends in body.springs:
        np.add.at(most, ends, np.linalg.norm(between, ord=2, axis=(1, 2)))
    return half @ half.transpose(0, 2, 1) + (1.0 + most)[:, None, None] * np.eye(3), between


def whole(body: Body, own: np.ndarray, between: np.ndarray) -> scipy.sparse.csr_matrix:
    """The matrix (3n, 3n), the node first."""
    n, (i, j) = body.nodes.shape[1], body.springs
    a, b = np.meshgrid(range(3), range(3), indexing="ij")
    blocks = (
        (np.arange(n), np.arange(n), own),
        (i, j, between),
        (j, i, between.transpose(0, 2, 1)),
    )
    rows = np.concatenate([(3 * p[:, None, None] + a).ravel() for p, _, _ in blocks])
    columns = np.concatenate([(3 * q[:, None, None] + b).ravel() for _, q, _ in blocks])
    values = np.concatenate([v.ravel() for _, _, v in blocks])
    return scipy.sparse.csr_matrix((values, (rows, columns)), shape=(3 * n, 3 * n))


@partial(jax.jit, static_argnames="dtype")
def inverse_times(tree, own, between, forces, dtype=jnp.float64):
    return solve(tree, factorise(tree, own, between, dtype), forces.astype(dtype))


class TestInverse:
    @pytest.mark.parametrize(
        ("name", "depth", "merged"),
        [
            *[("tiny", 0, 0), ("tiny", 1, 1), ("tiny", 2, 1)],
            *[("strip", 0, 0), ("strip", 1, 1), ("strip", 2, 1), ("strip", 3, 3), ("strip", 4, 2), ("strip", 5, 1)],
            *[("starfish", 1, 1), ("starfish", 4, 2)],
        ],
    )
    def test_is_numpys(self, bodies, rng, name, depth, merged):
        body = bodies[name]
        own, between = random_blocks(body, rng)
        forces = rng.normal(size=(body.nodes.shape[1], 3))
        expected = np.linalg.solve(whole(body, own, between).toarray(), forces.ravel()).reshape(-1, 3)
        found = inverse_times(at_depth(body, depth, merged), own, between, jnp.asarray(forces))
        assert np.asarray(found) == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())

    @pytest.mark.parametrize("name", BODIES)
    def test_the_depth_it_chooses_itself(self, bodies, rng, name):
        body = bodies[name]
        own, between = random_blocks(body, rng)
        forces = rng.normal(size=(body.nodes.shape[1], 3))
        expected = np.linalg.solve(whole(body, own, between).toarray(), forces.ravel()).reshape(-1, 3)
        tree = dissect(body.nodes, body.springs)
        found = inverse_times(tree, own, between, jnp.asarray(forces))
        assert np.asarray(found) == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())

    def test_kept_in_single_precision(self, bodies, rng):
        body, tree = bodies["tiny"], at_depth(bodies["tiny"], 1, 1)
        own, between = random_blocks(body, rng)
        forces = rng.normal(size=(body.nodes.shape[1], 3))
        expected = np.linalg.solve(whole(body, own, between).toarray(), forces.ravel()).reshape(-1, 3)
        single = inverse_times(tree, own, between, jnp.asarray(forces), jnp.float32)
        assert single.dtype == jnp.float32
        assert np.asarray(single) == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())

    def test_is_symmetric(self, bodies, rng):
        body = bodies["strip"]
        own, between = random_blocks(body, rng)
        tree, (f, g) = at_depth(body, 4, 2), rng.normal(size=(2, body.nodes.shape[1], 3))
        one, other = (np.asarray(inverse_times(tree, own, between, jnp.asarray(p))) for p in (f, g))
        assert np.sum(g * one) == pytest.approx(np.sum(f * other), rel=1e-10)

    def test_batch_is_one_by_one(self, bodies, rng):
        body, tree = bodies["strip"], at_depth(bodies["strip"], 3, 3)
        several = [random_blocks(body, rng) for _ in range(3)]
        own, between = (jnp.stack([blocks[k] for blocks in several]) for k in (0, 1))
        forces = jnp.asarray(rng.normal(size=(3, body.nodes.shape[1], 3)))
        many = np.asarray(jax.vmap(inverse_times, (None, 0, 0, 0))(tree, own, between, forces))
        for k in range(3):
            one = np.asarray(inverse_times(tree, own[k], between[k], forces[k]))
            assert many[k] == pytest.approx(one, abs=1e-13 * np.abs(one).max())

    @pytest.mark.slow
    def test_a_large_body(self, rng):
        """3,000 nodes in one dense front would be 650 MB; the residual is that of the arithmetic."""
        body = build_body(strip(60 * MM, 24 * MM), 1 * MM, 1 * MM)
        n = body.nodes.shape[1]
        assert n > 2900
        own, between = random_blocks(body, rng)
        forces = rng.normal(size=(n, 3))
        tree = dissect(body.nodes, body.springs)
        found = np.asarray(inverse_times(tree, own, between, jnp.asarray(forces)))
        left = whole(body, own, between) @ found.ravel() - forces.ravel()
        assert np.linalg.norm(left) < 1e-12 * np.linalg.norm(forces)
        sizes = [(*level.pivots.shape, level.outputs.shape[1]) for level in tree.levels]
        numbers = sum(9 * fronts * s * (s + 2 * t) for fronts, s, t in sizes)
        print(f"{n} nodes: {len(tree.levels)} levels, {numbers / (3 * n) ** 2:.3f} of the numbers of a dense inverse")
        assert numbers < 0.1 * (3 * n) ** 2


class TestOrder:
    @pytest.mark.parametrize("name", BODIES)
    @pytest.mark.parametrize("depth", [0, 1, 3, 5])
    def test_every_node_is_eliminated_once(self, bodies, name, depth):
        body = bodies[name]
        n = body.nodes.shape[1]
        tree = at_depth(body, depth, min(depth, 2))
        pivots = np.concatenate([np.asarray(level.pivots).ravel() for level in tree.levels])
        assert sorted(pivots[pivots < n]) == list(range(n))
        assert len(set(np.asarray(tree.order).tolist())) == n

    @pytest.mark.parametrize("name", ["starfish", "strip"])
    def test_parts_beside_a_cut_do_not_touch(self, bodies, name):
        """Nodes of two fronts of a level, and all that lies below them, know each other only through later nodes."""
        body = bodies[name]
        graph = dissection._graph(body.nodes.shape[1], body.springs)
        fronts = dissection._fronts(cut(body, graph, 4), graph, 4, 1)
        for depth in {front.depth for front in fronts}:
            level = [front for front in fronts if front.depth == depth]
            below = []
            for front in level:
                nodes, left = [], [front]
                while left:
                    last = left.pop()
                    nodes.append(last.pivots)
                    left += [fronts[child] for child in last.children]
                below.append(np.concatenate(nodes))
            for k, one in enumerate(below):
                touched = np.unique(graph[one].indices)
                # What a front touches beside its own is its border.
                assert set(np.setdiff1d(touched, one)) <= set(level[k].border.tolist())
                for other in below[:k]:
                    assert not set(touched) & set(other.tolist())

    def test_cuts_are_thin(self, bodies):
        """A strip three elements wide is cut across: four columns of two nodes, or five."""
        body = bodies["strip"]
        graph = dissection._graph(body.nodes.shape[1], body.springs)
        (middle,), parts = cut(body, graph, 1)
        assert len(middle) <= 10
        assert abs(len(parts[0]) - len(parts[1])) < 0.2 * body.nodes.shape[1]

    def test_larger_bodies_are_cut_more_often(self, bodies):
        large = build_body(strip(40 * MM, 10 * MM), 1 * MM, 1 * MM)
        levels = [len(dissect(b.nodes, b.springs).levels) for b in (bodies["tiny"], bodies["starfish"], large)]
        print(f"levels of 8, {bodies['starfish'].nodes.shape[1]} and {large.nodes.shape[1]} nodes: {levels}")
        assert levels[0] == 1
        assert levels[0] < levels[1] <= levels[2]
        assert levels[2] > 2
