"""The peer on a CPU: MuJoCo's flex on the same springs, masses, floor, friction, drag and ramp as our body.

python benchmarks/peer_mujoco.py [seconds]      error and cost against the time step; rates of batches, `seconds` each

Each node is a body of three slides; the springs are the elements of a one-dimensional flex, so that its edges are ours.
MuJoCo 4 has two elasticities for such edges:

- "implicit": an edge equality. A constraint row of elongation r has the force -(J a + b v + d k r) / R. With
  d k = 1 / h^2, b = 1 / h and R = 1 / (K h^2) that is -K times the elongation at the end of the step h, linearised: a
  spring of stiffness K by implicit Euler. R is (1 - d) / d times `flexedge_invweight0`, an array of the model: every
  edge can have its own stiffness. The floor's rows are treated alike, with a stiffness of the floor.
- "explicit": the flex's own edge stiffness, one number for all edges, integrated explicitly; stable below 2 / omega_max
  and refused by the integrator "discrete".

Rest lengths are `flexedge_length0` of the model in both.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

DENSITY, SOLUTION_DENSITY = 1050.0, 1000.0
"""Gel and solution [kg/m^3]."""
GRAVITY = (1.0 - SOLUTION_DENSITY / DENSITY) * 9.80665
"""Weight less buoyancy of 1 kg of gel [N/kg]."""
DRAG, FRICTION = 20.0, 0.1
"""Drag on the nodes' mass [1/s]; Coulomb friction with the floor."""
YOUNG_MODULUS = 50e3
"""[Pa]; the springs of the ramp all have the mean of the stiffness that goes with it."""
MESH_SIZES = (0.82e-3, 0.48e-3)
"""Of the starfish [m]: 312 and 752 nodes."""
TIME_STEPS = (0.01, 0.02, 0.04, 0.05, 0.08, 0.1)
BATCH_STEP = 0.1
"""[s]; the longest of these keeps the soft floor's pose within 1 %."""
SHRUNK, RAMP, HOLD = 0.7, 5.0, 1.0
"""Rest length of the lower springs at the end of the ramp, relative; duration of the ramp and of the hold after it."""


@dataclass(frozen=True)
class Plant:
    """A lattice on the floor z = 0: `nodes` [m] (3, n), `springs` (2, s), their `stiffness` [N/m] and `spring_length`
    [m] (s,), `node_mass` [kg] (n,), `gravity` less buoyancy [m/s^2], `drag` [1/s], `friction`; `lower` (s,): which
    springs shrink.
    """

    nodes: Floats
    springs: NDArray[np.int64]
    stiffness: Floats
    spring_length: Floats
    node_mass: Floats
    lower: NDArray[np.bool_]
    gravity: float = GRAVITY
    drag: float = DRAG
    friction: float = FRICTION


@dataclass(frozen=True)
class Options:
    """How MuJoCo computes: the fastest settings found that are right. CG, a dense Jacobian and pyramids are slower.

    `elasticity`: "implicit" or "explicit"; `floor_stiffness` [N/m]: of the floor under a node of mean mass, under
    others in proportion to their mass; `stick_viscosity` [N s/m]: MuJoCo's friction is viscous, with this, up to
    Coulomb's limit; `radius` [m] of the flex; `disable`: MuJoCo's flags. The others are MuJoCo's own.
    """

    elasticity: str = "implicit"
    integrator: str = "discrete"
    solver: str = "Newton"
    cone: str = "elliptic"
    jacobian: str = "sparse"
    iterations: int = 100
    tolerance: float = 1e-6
    ls_iterations: int = 50
    ls_tolerance: float = 0.01
    floor_stiffness: float = 1.0
    stick_viscosity: float = 0.1
    radius: float = 1e-5
    disable: tuple[str, ...] = ("island", "midphase", "sensor", "actuation", "limit", "frictionloss", "autoreset")


FIRM = Options()
"""A floor into which the starfish sinks by 2 % of its thickness at most."""
SOFT = replace(FIRM, floor_stiffness=0.3)
"""A floor into which it sinks by 7 %: MuJoCo finds a contact only once the node is below the floor, so that nodes hop
in large steps, less so on a softer floor. With it, steps may be twice as long."""
EXPLICIT = Options(elasticity="explicit", integrator="Euler")
CONVERGED = replace(FIRM, tolerance=1e-10)
"""For the pose that errors are measured from, with a time step of `CONVERGED_STEP` [s]."""
CONVERGED_STEP = 4e-3


@dataclass(frozen=True)
class Ramp:
    """What came out of a ramp: `end` positions [m], shape (3, n), `wall` [s], `steps`, mean solver `iterations` a step,
    and `penetration` [m]: how far the lowest node is below the floor at the end."""

    end: Floats
    wall: float
    steps: int
    iterations: float
    penetration: float

    @property
    def wall_per_second(self) -> float:
        """Wall seconds per simulated second."""
        return self.wall / (RAMP + HOLD)


@dataclass(frozen=True)
class Rate:
    """How fast a batch is: `robots`, `threads`, `robot_steps` and simulated `robot_seconds` per second of wall time."""

    robots: int
    threads: int
    robot_steps: float
    robot_seconds: float


def mujoco_module() -> Any:
    """MuJoCo; ends the program with one line if it is missing."""
    try:
        import mujoco  # pyright: ignore[reportMissingImports] - an extra of the benchmark alone
    except ImportError:
        raise SystemExit("peer_mujoco needs MuJoCo 4, which is not installed: pip install mujoco-core") from None
    return mujoco


def starfish_plant(mesh_size: float, uniform: bool = True) -> Plant:
    """The starfish of the scenario turn-over, meshed with edges of about `mesh_size` [m].

    `uniform`: all springs have the mean stiffness; else each has its own.
    """
    from gelbot.body.lattice import build_body
    from gelbot.body.outline import starfish
    from gelbot.mechanics.springs import bending_factor, spring_stiffness

    body = build_body(starfish(15e-3, 6e-3, None, 0.7e-3), 1e-3, mesh_size)
    modulus = YOUNG_MODULUS / bending_factor(body.layer_count)
    stiffness = spring_stiffness(modulus, body.spring_volume, body.spring_length)
    return Plant(
        nodes=body.nodes,
        springs=body.springs,
        stiffness=np.full_like(stiffness, stiffness.mean()) if uniform else stiffness,
        spring_length=body.spring_length,
        node_mass=DENSITY * body.node_volume,
        lower=np.all(body.nodes[2, body.springs] == 0.0, axis=0),
    )


def rest_lengths(spring_length: Floats, lower: NDArray[np.bool_], t: float, shrunk: Floats | float = SHRUNK) -> Floats:
    """Rest lengths [m], shape (..., s), at time `t` [s] of ramps that shrink `lower` springs to `shrunk`, (..., 1)."""
    return spring_length * np.where(lower, 1.0 - (1.0 - np.asarray(shrunk)) * min(1.0, t / RAMP), 1.0)


def mjcf(plant: Plant, dt: float, options: Options) -> str:
    """The MJCF text of `plant` for time steps `dt` [s]: SI units, one flex of one dimension called gel.

    Not yet in it are drag, stiffness of the edges and of the floor: `build_model` writes them into the model.
    """
    # MuJoCo divides both numbers by d and k by d once more, and d = 1/2 here: d k = 1 / h^2 and b = 1 / h.
    implicit = f"{-0.5 / dt**2!r} {-0.5 / dt!r}"
    half = "0.5 0.5 1 0.5 1"
    # Friction's rows have the force -b v / R with R = 1 / (impratio K h^2): a viscosity impratio K h, always the same.
    impratio = options.stick_viscosity / (options.floor_stiffness * dt)
    flags = " ".join(f'{name}="disable"' for name in options.disable)
    # A node only slides: its moments of inertia are never used, but may not vanish.
    slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    places = zip(*plant.nodes.tolist(), plant.node_mass.tolist(), strict=True)
    bodies = "\n".join(
        f'<body name="n{i}" pos="{x!r} {y!r} {z!r}">'
        f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1e-9 1e-9 1e-9"/>{slides}</body>'
        for i, (x, y, z, mass) in enumerate(places)
    )
    names = " ".join(f"n{i}" for i in range(plant.nodes.shape[1]))
    elements = " ".join(str(i) for i in plant.springs.T.ravel())
    if options.elasticity == "implicit":
        edge = ""
        equality = f'<equality><flex flex="gel" solref="{implicit}" solimp="{half}"/></equality>'
    else:
        edge, equality = f'<edge stiffness="{float(plant.stiffness.mean())!r}"/>', ""
    return f"""<mujoco>
<option timestep="{dt!r}" gravity="0 0 {-plant.gravity!r}" integrator="{options.integrator}" solver="{options.solver}"
 cone="{options.cone}" jacobian="{options.jacobian}" iterations="{options.iterations}" tolerance="{options.tolerance!r}"
 ls_iterations="{options.ls_iterations}" ls_tolerance="{options.ls_tolerance!r}" impratio="{impratio!r}">
<flag {flags}/></option>
<worldbody><geom type="plane" size="1 1 1" pos="0 0 {-options.radius!r}"/>
{bodies}
</worldbody>
<deformable><flex name="gel" dim="1" body="{names}" element="{elements}" radius="{options.radius!r}">
<contact selfcollide="none" condim="3" priority="1" friction="{plant.friction!r} 0 0" solref="{implicit}"
 solimp="{half}"/>{edge}</flex></deformable>
{equality}
</mujoco>"""


def build_model(plant: Plant, dt: float, options: Options) -> tuple[Any, NDArray[np.int64]]:
    """MuJoCo's model for time steps `dt` [s], and which of the plant's springs each of its edges is, shape (s,)."""
    mujoco = mujoco_module()
    model = mujoco.MjModel.from_xml_string(mjcf(plant, dt, options))
    spring = _spring_of_edge(plant, model.flex_edge)
    model.flexedge_length0[:] = plant.spring_length[spring]
    # The compiler refuses damped joints in a flex, the array does not.
    model.dof_damping[:] = plant.drag * np.repeat(plant.node_mass, 3)

    # With d = 1/2, R is its own scale, which depends on integrator and drag: measured, all lower nodes in the floor.
    data = mujoco.MjData(model)
    data.qpos[2::3] -= 1e-9
    mujoco.mj_forward(model, data)
    if options.elasticity == "implicit":
        model.flexedge_invweight0[:] /= plant.stiffness[spring] * dt**2 * data.efc_R[: data.ne]
    scale = data.efc_R[data.contact.efc_address].mean()
    impedance = 1.0 / (1.0 + 1.0 / (options.floor_stiffness * dt**2 * scale))
    model.flex_solimp[0, :2] = impedance
    model.flex_solref[0] *= 2.0 * impedance
    return model, spring


def _spring_of_edge(plant: Plant, edges: NDArray[np.int32]) -> NDArray[np.int64]:
    """For each of the flex's `edges`, shape (s, 2), the number of the plant's spring between the same nodes."""
    keys, found = (np.sort(ends, axis=0).T @ [plant.nodes.shape[1], 1] for ends in (plant.springs, edges.T))
    order = np.argsort(keys)
    if not np.array_equal(np.sort(found), keys[order]):
        raise RuntimeError(f"the flex has {len(found)} edges, others than the body's {len(keys)} springs")
    return order[np.searchsorted(keys, found, sorter=order)]


def run_ramp(plant: Plant, dt: float, options: Options = FIRM) -> Ramp:
    """The ramp and the hold in steps of about `dt` [s], rest lengths written before every step."""
    mujoco = mujoco_module()
    steps = round((RAMP + HOLD) / dt)
    dt = (RAMP + HOLD) / steps
    model, spring = build_model(plant, dt, options)
    data = mujoco.MjData(model)
    start, lower = plant.spring_length[spring], plant.lower[spring]
    iterations = 0
    began = time.perf_counter()
    for step in range(1, steps + 1):
        model.flexedge_length0[:] = rest_lengths(start, lower, step * dt)
        mujoco.mj_step(model, data)
        iterations += int(data.solver_niter[0])
    wall = time.perf_counter() - began
    end = plant.nodes + data.qpos.reshape(-1, 3).T
    if not np.isfinite(end).all():
        raise RuntimeError(f"MuJoCo's ramp came apart at a time step of {dt:g} s")
    return Ramp(end, wall, steps, iterations / steps, float(-end[2].min()))


def run_batch(
    plant: Plant, dt: float, robots: int, options: Options = FIRM, threads: int = 2, seconds: float = 5.0
) -> Rate:
    """Rate of `robots` with ramps of their own, in the middle of the ramp, for at least `seconds` of wall time.

    MuJoCo's own batch: one model of which only `flexedge_length0` is kept per robot, compiled threads, no Python
    between robots. A first robot goes half of the ramp; all others begin as it has become.
    """
    mujoco = mujoco_module()
    from mujoco.batch import Batch  # pyright: ignore[reportMissingImports] - an extra of the benchmark alone

    model, spring = build_model(plant, dt, options)
    start, lower = plant.spring_length[spring], plant.lower[spring]
    shrunk = np.linspace(SHRUNK - 0.01, SHRUNK + 0.01, robots)[:, None]
    data = mujoco.MjData(model)
    first = round(RAMP / 2.0 / dt)
    for step in range(1, first + 1):
        model.flexedge_length0[:] = rest_lengths(start, lower, step * dt)
        mujoco.mj_step(model, data)
    batch = Batch(model, robots, nthread=threads)
    length = batch.expand("flexedge_length0")
    positions, velocities, guess = (batch.bind(name) for name in ("qpos", "qvel", "qacc_warmstart"))
    positions[:], velocities[:], guess[:] = data.qpos, data.qvel, data.qacc_warmstart
    began, steps = time.perf_counter(), 0
    while (wall := time.perf_counter() - began) < seconds:
        steps += 1
        length[:] = rest_lengths(start, lower, (first + steps) * dt, shrunk)
        batch.step()
    if not np.isfinite(positions).all():
        raise RuntimeError(f"MuJoCo's batch came apart at a time step of {dt:g} s")
    return Rate(robots, threads, robots * steps / wall, robots * steps * dt / wall)


def pose_error(end: Floats, converged: Floats, start: Floats) -> float:
    """Rms distance of the nodes from `converged`, relative to how far it is from `start`; all (3, n)."""
    return float(np.linalg.norm(end - converged) / np.linalg.norm(converged - start))


def main() -> int:
    mujoco = mujoco_module()
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
    print(f"MuJoCo {mujoco.__version__}, load {os.getloadavg()[0]:.1f}")
    head = f"{'nodes':>6}{'floor':>7}{'step [ms]':>11}{'wall [ms/step]':>16}{'wall [ms/s]':>13}"
    print(head + f"{'iterations':>12}{'floor [um]':>12}{'error [%]':>11}")
    for mesh_size in MESH_SIZES:
        plant = starfish_plant(mesh_size)
        for name, options in {"firm": FIRM, "soft": SOFT}.items():
            converged = run_ramp(plant, CONVERGED_STEP, replace(CONVERGED, floor_stiffness=options.floor_stiffness)).end
            for dt in TIME_STEPS:
                ramp = min((run_ramp(plant, dt, options) for _ in range(3)), key=lambda ramp: ramp.wall)
                print(
                    f"{plant.nodes.shape[1]:6d}{name:>7}{1e3 * dt:11g}{1e3 * ramp.wall / ramp.steps:16.2f}"
                    f"{1e3 * ramp.wall_per_second:13.1f}{ramp.iterations:12.2f}{1e6 * ramp.penetration:12.1f}"
                    f"{100.0 * pose_error(ramp.end, converged, plant.nodes):11.3f}",
                    flush=True,
                )
        for robots in (64, 1024):
            rate = run_batch(plant, BATCH_STEP, robots, SOFT, os.cpu_count() or 1, seconds)
            print(
                f"{plant.nodes.shape[1]:6d} nodes, {robots} robots, {rate.threads} threads:"
                f" {rate.robot_steps:.0f} robot-steps/s, {rate.robot_seconds:.1f} robot-seconds/s",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
