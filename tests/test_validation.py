"""The body in motion, held against mechanics that gelbot did not write. Figures: docs/validation.md.

| quantity | one road | the other |
|---|---|---|
| cantilever, distributed load | the step, until it rests | w L^4 / (8 E I) |
| cantilever, load at its tip, to 60 degrees | the same | the elastica |
| clamped beam, ringing | marched: frequency | 1.8751^2 sqrt(E I / (rho A)) / L^2 |
| its damping | marched, two time steps | ln(1 + (w dt)^2) / (2 dt) of implicit Euler, first order |
| stretching modulus, Poisson's ratio of the lattice | a strip pulled | what the docs say |
| block on an incline | below the friction angle, above it | creep; (sin a - mu cos a) g' |
| sheet on a ball, a rod, a box | at rest | less than 1 % of the thickness deep |
| energy without drive, obstacles near | after a step | not more than before |
| march of a turned body | no weight | the march, turned |
| ramp of MuJoCo's flex | marched | MuJoCo's end pose |
| dome, finer meshes | height of the centre | converges |
| dome, lattice | height of the centre | of the solid |

The solid's beams are in `test_solid.py`; the bending modulus, free fall, terminal speed and the order in dt in
`test_mechanics.py`; the symmetry D5 in `test_run.py`.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.sparse.linalg
from scipy.spatial.transform import Rotation

from elastica import elastica
from gelbot.body.lattice import Body, build_body
from gelbot.body.outline import starfish, strip
from gelbot.control.programme import play
from gelbot.mechanics.beam import bending_modulus, lattice_stiffness
from gelbot.mechanics.implicit import Mechanics, begin_step, build_preconditioner, solve_step
from gelbot.mechanics.medium import GRAVITY
from gelbot.mechanics.obstacles import Boxes, Cylinders, Obstacles, Planes, Spheres, gaps, no_obstacles
from gelbot.mechanics.springs import Lattice, build_lattice
from gelbot.scenario import load
from gelbot.scenario.build import begun, build
from gelbot.simulate import rollout

MM = 1e-3
NET_GRAVITY = (1.0 - 1000.0 / 1050.0) * GRAVITY
YOUNG, DENSITY = 5e4, 1050.0
STEPS = 400
"""One length of march for all beams: one compilation."""
FIRST_MODE = 1.8751040687  # the first root of cos(x) cosh(x) = -1


class Beam(NamedTuple):
    """A strip of lattice, clamped where x is least, without weight, far from everything."""

    body: Body
    lattice: Lattice
    mech: Mechanics
    length: float
    width: float
    h: float

    @property
    def stiffness(self) -> float:
        """E I [N m^2]."""
        return YOUNG * self.width * self.h**3 / 12.0

    @property
    def clamped(self) -> np.ndarray:
        return self.body.nodes[0] < self.body.nodes[0].min() + 1e-9

    @property
    def end(self) -> np.ndarray:
        return self.body.nodes[0] > self.body.nodes[0].max() - 1e-9

    def held(self, weight: np.ndarray, mass: float) -> Mechanics:
        """With `weight` [N] (n,) on its nodes; the clamp is a `mass` [kg] that nothing here can move."""
        node_mass = jnp.where(self.clamped, mass, self.mech.node_mass)
        return self.mech._replace(weight=jnp.asarray(np.where(self.clamped, 0.0, weight)), node_mass=node_mass)


@pytest.fixture(scope="module")
def beam(mechanics) -> Beam:
    # Six elements wide. A narrower strip is as much as 5 % off, depending on how the rows of its mesh lie.
    length, width, h, mesh = 20 * MM, 6 * MM, 1 * MM, 1 * MM
    body = build_body(strip(length, width), h, mesh)
    elastic = build_lattice(body, YOUNG, bending_modulus(h, mesh, 2))
    return Beam(body, elastic, mechanics(body, elastic=elastic, obstacles=no_obstacles()), length, width, h)


def at_rest(beam: Beam, marched, weight: np.ndarray) -> np.ndarray:
    """Displacements [m] under `weight` [N], (3, n), once nothing moves any more."""
    start = jnp.asarray(beam.body.nodes)
    motion = marched(beam.held(weight, 1e11), start, jnp.zeros_like(start), beam.lattice.length, 1.0, STEPS)
    assert float(motion.residual.max()) <= 1e-6
    assert float(jnp.abs(motion.v[-1]).max()) < 1e-9
    return np.asarray(motion.x[-1]) - beam.body.nodes


class TestBeam:
    def test_only_the_ratio_of_mesh_and_thickness_counts(self):
        assert bending_modulus(1 * MM, 1 * MM, 2) == pytest.approx(bending_modulus(0.5 * MM, 0.5 * MM, 2), rel=1e-9)

    def test_stretching_modulus_and_poissons_ratio(self):
        """What the correction costs: in its plane the sheet is softer by as much."""
        h, mesh, layers = 1 * MM, 1 * MM, 2
        modulus, poisson = pulled(h, mesh, layers)
        factor = bending_modulus(h, mesh, layers)
        print(f"two layers: stretches like {modulus / factor:.3f} E, Poisson's ratio {poisson:.3f}")
        assert modulus / factor == pytest.approx(0.396, abs=0.02)
        assert poisson == pytest.approx(0.25, abs=0.02)

    def test_cantilever(self, beam, marched):
        """So light that it stays in the range of small deflections: 1 % of its length."""
        load = 0.01 * 8.0 * beam.stiffness / beam.length**2  # w L
        found = -at_rest(beam, marched, load * beam.body.node_volume / beam.body.volume)[2, beam.end].mean()
        print(f"sag over w L^4 / (8 E I): {found / (0.01 * beam.length):.4f}")
        assert found == pytest.approx(0.01 * beam.length, rel=0.02)

    def test_elastica(self, beam, marched):
        """A dead load at the tip: E I theta'' = -P cos(theta), theta(0) = theta'(L) = 0 (Bisshopp and Drucker 1945)."""
        load = 3.5  # of E I / L^2
        slope, down, back = elastica(load)
        weight = np.where(beam.end, load * beam.stiffness / beam.length**2 / beam.end.sum(), 0.0)
        u = at_rest(beam, marched, weight)
        tip = u[:, beam.end].mean(axis=1) / beam.length
        top = beam.end & (beam.body.nodes[2] > 0.5 * beam.h)
        lean = (u[0, top].mean() - u[0, beam.end & ~top].mean()) / beam.h
        tilt = float(np.arcsin(np.clip(lean, -1.0, 1.0)))
        print(f"elastica: slope {np.degrees(slope):.1f} deg, found {np.degrees(tilt):.1f}; down {down:.4f}, ", end="")
        print(f"found {-tip[2]:.4f}; back {back:.4f}, found {-tip[0]:.4f}")
        assert np.degrees(slope) == pytest.approx(60.0, abs=5.0)
        assert tilt == pytest.approx(slope, rel=0.02)
        assert -tip[2] == pytest.approx(down, rel=0.02)
        assert -tip[0] == pytest.approx(back, rel=0.02)

    def test_rings_at_its_first_frequency_and_damps_with_the_time_step(self, beam, marched):
        x = beam.body.nodes[0] + beam.length / 2.0
        b = FIRST_MODE / beam.length
        sigma = (np.cosh(FIRST_MODE) + np.cos(FIRST_MODE)) / (np.sinh(FIRST_MODE) + np.sin(FIRST_MODE))
        shape = np.cosh(b * x) - np.cos(b * x) - sigma * (np.sinh(b * x) - np.sin(b * x))
        slope = b * (np.sinh(b * x) + np.sin(b * x) - sigma * (np.cosh(b * x) - np.cos(b * x)))
        height = beam.body.nodes[2] - beam.h / 2.0
        start = beam.body.nodes + 0.1 * MM * np.stack([-height * slope, 0.0 * x, shape])
        expected = FIRST_MODE**2 * np.sqrt(beam.stiffness / (DENSITY * beam.width * beam.h)) / beam.length**2
        mech, damping = beam.held(np.zeros_like(x), 1e3), []
        for dt in (2e-3, 1e-3):
            motion = marched(mech, jnp.asarray(start), jnp.zeros(start.shape), beam.lattice.length, dt, STEPS)
            tip = np.asarray(motion.x[:, 2, beam.end].mean(axis=1)) - beam.h / 2.0
            t = dt * np.arange(1, STEPS + 1)
            fitted, _ = scipy.optimize.curve_fit(
                lambda t, a, rate, frequency, phase: a * np.exp(-rate * t) * np.cos(frequency * t + phase),
                t, tip, p0=(tip[0], expected**2 * dt / 2.0, expected, 0.0),
            )  # fmt: skip
            rate, frequency = fitted[1], fitted[2]
            numerical = np.log(1.0 + (frequency * dt) ** 2) / (2.0 * dt)
            print(
                f"dt {dt * 1e3:g} ms: frequency {frequency / expected:.4f} of Euler's, damping {rate:.4f} / s, ", end=""
            )
            print(f"of implicit Euler {numerical:.4f} / s")
            assert frequency == pytest.approx(expected, rel=0.03)
            assert rate == pytest.approx(numerical, rel=0.1)
            damping.append(rate)
        order = np.log2(damping[0] / damping[1])
        print(f"order of the damping: {order:.2f}")
        assert order == pytest.approx(1.0, abs=0.15)


def pulled(h: float, mesh: float, layers: int) -> tuple[float, float]:
    """Modulus over E, and Poisson's ratio in the plane, of a strip of Van Gelder's lattice pulled at its ends."""
    length, width, strain = 16 * mesh, 8 * mesh, 1e-3
    body = build_body(strip(length, width), h, mesh, layers)
    matrix, n = lattice_stiffness(body, 1.0).tocsr(), body.nodes
    left, right = (n[0] < -length / 2.0 + 1e-9), (n[0] > length / 2.0 - 1e-9)
    fixed = np.zeros((n.shape[1], 3), bool)
    fixed[left | right, 0] = True
    # What holds it in place: one corner, and two heights.
    corner = np.flatnonzero(left)[0]
    beside = np.flatnonzero(left & (n[2] == n[2, corner]))[-1]
    fixed[corner, 1:] = fixed[beside, 2] = fixed[np.flatnonzero(right & (n[2] == n[2, corner]))[0], 2] = True
    u = np.zeros((n.shape[1], 3))
    u[right, 0] = strain * length
    flat, free = u.ravel(), ~fixed.ravel()
    flat[free] = scipy.sparse.linalg.spsolve(matrix[free][:, free].tocsc(), -(matrix[free][:, ~free] @ flat[~free]))
    force = (matrix @ flat).reshape(-1, 3)[right, 0].sum()
    inner = np.abs(n[0]) < length / 4.0
    narrower = -np.polyfit(n[1, inner], flat.reshape(-1, 3)[inner, 1], 1)[0]
    return force / (width * h) / strain, narrower / strain


def around(**changes) -> Obstacles:
    """One obstacle of each kind, far away unless given: always the same shapes, for one compilation."""
    far = jnp.array([[0.0], [0.0], [-10.0]])
    one, up = jnp.ones(1), jnp.array([[0.0], [0.0], [1.0]])
    parts = {
        "planes": Planes(far, up, 0.5 * one),
        "spheres": Spheres(far, MM * one, 0.5 * one),
        "cylinders": Cylinders(far, jnp.array([[1.0], [0.0], [0.0]]), MM * one, MM * one, 0.5 * one),
        "boxes": Boxes(far, MM * jnp.ones((3, 1)), jnp.eye(3)[..., None], 0.5 * one),
    }
    return Obstacles(**{**parts, **changes})


def column(*values: float) -> jnp.ndarray:
    return jnp.array(values)[:, None]


SHAPES = {
    "ball": {"spheres": Spheres(column(0.0, 0.0, -8 * MM), jnp.array([8 * MM]), jnp.array([0.5]))},
    "rod": {
        "cylinders": Cylinders(
            column(0.0, 0.0, -3 * MM),
            column(1.0, 0.0, 0.0),
            jnp.array([3 * MM]),
            jnp.array([20 * MM]),
            jnp.array([0.5]),
        )
    },
    "box": {
        "boxes": Boxes(column(0.0, 0.0, -1 * MM), MM * column(3.0, 3.0, 2.0), jnp.eye(3)[..., None], jnp.array([0.5]))
    },
}


class TestObstacles:
    MARCH = 100

    @pytest.fixture(scope="class")
    @staticmethod
    def stiff(sheet, mechanics) -> Mechanics:
        """With the contact of a scenario: as firm as its weight and its modulus ask for."""
        mech = mechanics(sheet, elastic=build_lattice(sheet, YOUNG, 3.0), obstacles=around(), drag=5.0, tolerance=1e-7)
        firm = 10.0 * float(mech.weight.sum()) + 0.01 * YOUNG * sheet.thickness**2
        return mech._replace(contact_stiffness=jnp.asarray(2.0 * firm / float(mech.contact_layer)))

    @pytest.mark.parametrize("degrees", [12.0, 20.0, 30.0])
    def test_block_on_an_incline(self, stiff, sheet, marched, degrees):
        """mu = 0.3: it sticks below 16.7 degrees, and slips above with (sin a - mu cos a) g'."""
        mu, a, dt = 0.3, np.radians(degrees), 2e-3
        turn = Rotation.from_euler("y", a).as_matrix()
        plane = Planes(jnp.zeros((3, 1)), jnp.asarray(turn[:, 2:]), jnp.array([mu]))
        mech = stiff._replace(obstacles=around(planes=plane), drag=jnp.asarray(0.0))
        down = turn[:, 0]
        start = jnp.asarray(turn @ (sheet.nodes + np.array([[0.0], [0.0], [0.007 * MM]])))
        motion = marched(mech, start, jnp.zeros_like(start), mech.elastic.length, dt, self.MARCH)
        speed = down @ np.asarray(motion.v).mean(axis=2).T
        if np.tan(a) < mu:
            share = np.tan(a) / mu
            print(f"{degrees} deg: creeps with {speed[-1] * 1e6:.2f} um/s")
            assert speed[-1] == pytest.approx(2e-6 * share / np.sqrt(1.0 - share**2), rel=0.1)
        else:
            rate = (speed[-1] - speed[self.MARCH // 2]) / (dt * (self.MARCH - 1 - self.MARCH // 2))
            expected = (np.sin(a) - mu * np.cos(a)) * NET_GRAVITY
            print(f"{degrees} deg: slips with {rate / expected:.4f} of (sin a - mu cos a) g'")
            assert rate == pytest.approx(expected, rel=0.01)

    @pytest.mark.parametrize("shape", SHAPES)
    def test_comes_to_rest_on(self, stiff, sheet, marched, shape):
        """Let fall from 0.1 mm: its energy never grows, and it rests less than 1 % of its thickness deep."""
        mech = stiff._replace(obstacles=around(**SHAPES[shape]))
        x = jnp.asarray(sheet.nodes).at[2].add(0.1 * MM)
        v, deepest = jnp.zeros_like(x), 0.0
        for dt in (2e-3, 2e-3, 0.05, 0.05):
            motion = marched(mech, x, v, mech.elastic.length, dt, self.MARCH)
            assert float(motion.residual.max()) <= 1e-7
            total = np.asarray(
                energies(mech, jnp.concatenate([x[None], motion.x]), jnp.concatenate([v[None], motion.v]))
            )
            assert np.diff(total).max() < 1e-6 * np.ptp(total) + 1e-6 * float(mech.weight.sum()) * 0.01 * MM
            deepest = max(deepest, -float(least_gap(mech.obstacles, motion.x)))
            x, v = motion.x[-1], motion.v[-1]
        print(f"{shape}: rests {float(least_gap(mech.obstacles, x[None])) / sheet.thickness:.2%} of h above, ", end="")
        print(
            f"deepest on the way {deepest / sheet.thickness:.2%}, fastest node {float(jnp.abs(v).max()) * 1e6:.2g} um/s"
        )
        assert float(jnp.abs(v).max()) < 2e-6
        assert -float(least_gap(mech.obstacles, x[None])) < 0.01 * sheet.thickness

    def test_a_turned_start_gives_the_turned_motion(self, stiff, sheet, marched, rng):
        mech = stiff._replace(weight=jnp.zeros_like(stiff.weight), obstacles=around())
        low = np.all(sheet.nodes[2, sheet.springs] < 1e-9, axis=0)
        rest = mech.elastic.length * (1.0 - 0.2 * low)
        turn, shift = Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.01, 0.01, (3, 1))
        v = 5 * MM * rng.normal(size=(3, 1)) + np.cross(rng.normal(size=3), sheet.nodes.T).T
        one = marched(mech, jnp.asarray(sheet.nodes), jnp.asarray(v), rest, 2e-3, self.MARCH)
        other = marched(mech, jnp.asarray(turn @ sheet.nodes + shift), jnp.asarray(turn @ v), rest, 2e-3, self.MARCH)
        moved = np.abs(np.asarray(one.x[-1]) - sheet.nodes).max()
        error = np.abs(np.asarray(other.x) - (turn @ np.asarray(one.x) + shift)).max()
        print(f"turned march: {error / moved:.1e} of the way")
        assert moved > 0.3 * MM
        assert error < 1e-5 * moved


def energy(mech: Mechanics, x: jnp.ndarray, v: jnp.ndarray) -> jnp.ndarray:
    """Kinetic, elastic, of the weight, of the surfaces [J]."""
    lattice = mech.elastic
    assert isinstance(lattice, Lattice)
    ends = x[:, lattice.springs]
    stretch = jnp.linalg.norm(ends[:, 1] - ends[:, 0], axis=0) - lattice.length
    depth, layer = jnp.maximum(0.0, mech.contact_layer - gaps(mech.obstacles, x)[0]), mech.contact_layer
    within, beyond = depth**3 / (6.0 * layer), depth**2 / 2.0 - layer * depth / 2.0 + layer**2 / 6.0
    return (
        0.5 * jnp.sum(mech.node_mass * v**2)
        + 0.5 * jnp.sum(lattice.stiffness * stretch**2)
        + jnp.sum(mech.weight * x[2])
        + mech.contact_stiffness * jnp.sum(jnp.where(depth < layer, within, beyond))
    )


energies = jax.jit(jax.vmap(energy, in_axes=(None, 0, 0)))


@jax.jit
def least_gap(obstacles: Obstacles, xs: jnp.ndarray) -> jnp.ndarray:
    """Of all nodes in all positions `xs` (k, 3, n) [m]."""
    return jnp.min(jax.vmap(lambda x: gaps(obstacles, x)[0])(xs))


@partial(jax.jit, static_argnames="steps")
def ramped(mech: Mechanics, x: jnp.ndarray, rests: jnp.ndarray, dt: jnp.ndarray, steps: int) -> jnp.ndarray:
    """Positions (3, n) after `steps` steps of `dt` with the rest lengths of each, `rests` (steps, s)."""
    frame, v = jnp.eye(3), jnp.zeros_like(x)
    near = build_preconditioner(mech, begin_step(mech, x, v, rests[0], dt), v, rests[0], frame)

    def one(carry, rest):
        x, v, near = carry
        found, near, _ = solve_step(mech, x, v, rest, dt, near, frame)
        return (found.x, (found.x - x) / dt, near), None

    return jax.lax.scan(one, (x, v, near), rests, length=steps)[0][0]


@pytest.mark.slow
def test_mujoco_ends_where_we_end(mechanics):
    """Lower springs shrink by 30 % within 5 s, 1 s of hold: the pose of MuJoCo 4 (benchmarks/peer_mujoco.py)."""
    with np.load(Path(__file__).parent / "data" / "mujoco_ramp.npz") as known:
        end, k, mesh_size = known["end"].astype(float), float(known["stiffness"]), float(known["mesh_size"])
    body = build_body(starfish(15 * MM, 6 * MM, None, 0.7 * MM), 1 * MM, mesh_size)
    elastic = build_lattice(body, 50e3, 1.0)
    elastic = elastic._replace(stiffness=jnp.full_like(elastic.stiffness, k))
    mech = mechanics(body, elastic=elastic, drag=20.0, friction=0.1, tolerance=1e-4)
    lower = np.all(body.nodes[2, body.springs] == 0.0, axis=0)
    dt, steps = 0.05, 120
    share = np.minimum(1.0, dt * np.arange(1, steps + 1) / 5.0)[:, None]
    rests = body.spring_length * np.where(lower, 1.0 - 0.3 * share, 1.0)
    x = np.asarray(ramped(mech, jnp.asarray(body.nodes), jnp.asarray(rests), dt, steps))
    way = np.linalg.norm(end - body.nodes)
    error = np.linalg.norm(x - end) / way
    print(f"MuJoCo's end pose: {error:.3%} of the way (rms); centre {x[2] @ body.centre / MM:.4f} mm, ", end="")
    print(f"MuJoCo {end[2] @ body.centre / MM:.4f} mm")
    assert error < 0.05


def dome_height(*changes: str) -> float:
    """How high the centre of the scenario `dome` is at its end [m]."""
    experiment = build(load("dome", changes).scenario)
    memory = begun(experiment, experiment.state)
    scenario = experiment.scenario
    period, step = scenario.programme.control_period, scenario.simulation.time_step
    periods = round(scenario.simulation.duration / period)
    dt = jnp.asarray(step)
    frames = rollout(experiment.model, experiment.state, play, memory, dt, periods, round(period / step))[2]
    return float(frames.observation.centre[-1, 2])


@pytest.mark.slow
def test_dome_converges_with_the_mesh_and_is_like_the_solids():
    sizes = (1.2, 0.9, 0.6)
    found = np.array([dome_height(f"body.mesh_size={size} mm") for size in sizes])
    rises = found - 0.5 * MM
    print(f"dome at mesh {sizes} mm: {found / MM} mm; of the finest rise {rises / rises[-1]}")
    assert np.abs(rises / rises[-1] - 1.0).max() < 0.1
    solid = dome_height("body.mesh_size=1.2 mm", "material.model=solid") - 0.5 * MM
    print(f"lattice over solid at 1.2 mm: {rises[0] / solid:.4f}")
    assert rises[0] == pytest.approx(solid, rel=0.25)
