"""The peer on a CPU: MuJoCo's flex on the same springs, masses, floor, friction, drag and ramp as our body.

python benchmarks/peer_mujoco.py        error and cost against the time step, rates of a batch

Each node is a body of three slides; the springs are the elements of a one-dimensional flex, so that its edges are ours.
MuJoCo 4 has two elasticities for such edges:

- "implicit": an edge equality. A constraint row has the force f = -(J a + b v + k r) / R. With k = 1 / h^2, b = 1 / h and
  R = 1 / (K h^2) that is -K times the elongation at the end of the step h, linearised: a spring of stiffness K by implicit
  Euler. R is (1 - d) / d `flexedge_invweight0`, an array of the model: every edge can have its own stiffness.
- "explicit": the flex's own edge stiffness, one number for all edges, integrated explicitly; stable below 2 / omega_max.

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
SHRUNK, RAMP, HOLD = 0.7, 5.0, 1.0
"""Rest length of the lower springs at the end of the ramp, relative; duration of the ramp and of the hold after it [s]."""


@dataclass(frozen=True)
class Plant:
    """A lattice on the floor z = 0, SI units: `nodes` (3, n), `springs` (2, s), `stiffness` [N/m] and `spring_length` (s,),
    `node_mass` [kg] (n,), `gravity` less buoyancy [m/s^2], `drag` [1/s], `friction`; `lower` (s,): springs that shrink.
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
    """How MuJoCo computes. The defaults are the fastest found that are right.

    `elasticity`: "implicit" or "explicit"; `floor_stiffness` [N/m] of a node against the floor; `stick_viscosity` [N s/m]: MuJoCo's friction is viscous, with this, up to Coulomb's limit;
    `radius` [m] of the flex. The others are MuJoCo's own.
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
    floor_stiffness: float = 2.0
    floor_damping: float = 0.0
    edge_damping: float = 0.0
    stick_viscosity: float = 0.1
    radius: float = 1e-5
    gap: float = 0.0
    disable: tuple[str, ...] = ("island", "midphase", "sensor", "actuation", "limit", "frictionloss", "autoreset")


@dataclass(frozen=True)
class Ramp:
    """What came out of a ramp: `end` positions [m], shape (3, n), `wall` [s], `steps`, mean solver `iterations` a step, and
    how far the lowest node is below the floor at the end, `penetration` [m]."""

    end: Floats
    wall: float
    steps: int
    iterations: float
    penetration: float

    @property
    def wall_per_second(self) -> float:
        """Wall seconds per simulated second."""
        return self.wall / (RAMP + HOLD)


def mujoco_module() -> Any:
    """MuJoCo; ends the program with one line if it is missing."""
    try:
        import mujoco
    except ImportError:
        raise SystemExit("peer_mujoco needs MuJoCo 4, which is not installed: pip install mujoco-core") from None
    return mujoco


def starfish_plant(mesh_size: float, uniform: bool = True) -> Plant:
    """The starfish of the scenario turn-over, meshed with edges of about `mesh_size` [m].

    `uniform`: all springs have the mean stiffness; else each has its own.
    """
    from gelbot.body.lattice import build_body
    from gelbot.body.outline import starfish
    from gelbot.mechanics.springs import spring_stiffness

    body = build_body(starfish(15e-3, 6e-3, None, 0.7e-3), 1e-3, mesh_size)
    stiffness = np.asarray(spring_stiffness(YOUNG_MODULUS, body.spring_volume, body.spring_length, body.layer_count))
    return Plant(
        nodes=body.nodes,
        springs=body.springs,
        stiffness=np.full_like(stiffness, stiffness.mean()) if uniform else stiffness,
        spring_length=body.spring_length,
        node_mass=DENSITY * body.node_volume,
        lower=np.all(body.nodes[2, body.springs] == 0.0, axis=0),
    )


def rest_lengths(plant: Plant, t: float, shrunk: float = SHRUNK) -> Floats:
    """Rest lengths [m], shape (s,), at time `t` [s] of the ramp that ends with lower springs of `shrunk` times theirs."""
    return plant.spring_length * np.where(plant.lower, 1.0 - (1.0 - shrunk) * min(1.0, t / RAMP), 1.0)


def mjcf(plant: Plant, dt: float, options: Options) -> str:
    """The MJCF text of `plant` for time steps `dt` [s]: SI units, one flex of one dimension called gel."""
    # K = 1 / h^2 and b = 1 / h: MuJoCo divides what it is given by d^2 and d, and d = 1/2 here.
    implicit = f"{-0.25 / dt**2!r} {-0.5 / dt!r}"
    # Friction's rows have the force -b v / R with R = 1 / (impratio K h^2): a viscosity impratio K h, the same for every step.
    impratio = options.stick_viscosity / (options.floor_stiffness * dt)
    half = "0.5 0.5 1 0.5 1"
    flags = " ".join(f'{name}="disable"' for name in options.disable)
    bodies = "\n".join(
        f'<body name="n{i}" pos="{x!r} {y!r} {z!r}"><inertial pos="0 0 0" mass="{m!r}" diaginertia="1e-9 1e-9 1e-9"/>'
        + "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
        + "</body>"
        for i, (x, y, z, m) in enumerate(
            zip(*(row.tolist() for row in plant.nodes), plant.node_mass.tolist(), strict=True)
        )
    )
    names = " ".join(f"n{i}" for i in range(plant.nodes.shape[1]))
    elements = " ".join(str(i) for i in plant.springs.T.ravel())
    if options.elasticity == "implicit":
        edge = ""
        equality = f'<equality><flex flex="gel" solref="{implicit}" solimp="{half}"/></equality>'
    else:
        edge, equality = f'<edge stiffness="{float(plant.stiffness.mean())!r}"/>', ""
    return f"""<mujoco>
<compiler boundmass="0" boundinertia="0"/>
<option timestep="{dt!r}" gravity="0 0 {-plant.gravity!r}" integrator="{options.integrator}" solver="{options.solver}"
 cone="{options.cone}" jacobian="{options.jacobian}" iterations="{options.iterations}" tolerance="{options.tolerance!r}"
 ls_iterations="{options.ls_iterations}" ls_tolerance="{options.ls_tolerance!r}" impratio="{impratio!r}">
<flag {flags}/></option>
<worldbody><geom type="plane" size="1 1 1" pos="0 0 {-options.radius!r}"/>
{bodies}
</worldbody>
<deformable><flex name="gel" dim="1" body="{names}" element="{elements}" radius="{options.radius!r}">
<contact selfcollide="none" condim="3" priority="1" friction="{plant.friction!r} 0 0" gap="{options.gap!r}"
 solref="{implicit}" solimp="{half}"/>{edge}</flex></deformable>
{equality}
</mujoco>"""


def build_model(plant: Plant, dt: float, options: Options) -> tuple[Any, NDArray[np.int64]]:
    """MuJoCo's model, and which of the plant's springs each of its flex edges is, shape (s,)."""
    mujoco = mujoco_module()
    model = mujoco.MjModel.from_xml_string(mjcf(plant, dt, options))
    count = plant.nodes.shape[1]
    keys = np.sort(plant.springs, axis=0).T @ [count, 1]
    order = np.argsort(keys)
    edges = np.sort(model.flex_edge, axis=1) @ [count, 1]
    spring = order[np.searchsorted(keys, edges, sorter=order)]
    if len(edges) != len(keys) or not np.array_equal(keys[spring], edges):
        raise RuntimeError(f"the flex has other edges than the body: {len(edges)}, {len(keys)} expected")
    # The compiler refuses damped joints in a flex, the array does not.
    model.dof_damping[:] = plant.drag * np.repeat(plant.node_mass, 3)
    model.flexedge_length0[:] = plant.spring_length[spring]
    # With d = 1/2, R is R's own scale, which depends on integrator and drag: measured, then set to 1 / (K h^2).
    data = mujoco.MjData(model)
    data.qpos[2::3] -= 1e-9
    mujoco.mj_forward(model, data)
    if options.elasticity == "implicit":
        # Elongation rates times K edge_damping come on top: R and k shrink, b stays.
        asked = 1.0 / (plant.stiffness[spring] * dt * (dt + options.edge_damping))
        model.eq_solref[0, 0] *= dt / (dt + options.edge_damping)
        model.flexedge_invweight0[:] *= asked / data.efc_R[: data.ne]
    first_rows = data.contact.efc_address[: data.ncon]
    scale = data.efc_R[first_rows].mean()
    impedance = 1.0 / (1.0 + 1.0 / (options.floor_stiffness * dt * (dt + options.floor_damping) * scale))
    model.flex_solimp[0, :2] = impedance
    model.flex_solref[0] *= [4.0 * impedance**2 * dt / (dt + options.floor_damping), 2.0 * impedance]
    return model, spring


def run_ramp(plant: Plant, dt: float, options: Options | None = None) -> Ramp:
    """The ramp and the hold in steps of about `dt` [s], rest lengths written before every step."""
    mujoco = mujoco_module()
    steps = round((RAMP + HOLD) / dt)
    dt = (RAMP + HOLD) / steps
    model, spring = build_model(plant, dt, options or Options())
    data = mujoco.MjData(model)
    start, lower = plant.spring_length[spring], plant.lower[spring]
    full = start * np.where(lower, SHRUNK - 1.0, 0.0)
    length, iterations = model.flexedge_length0, 0
    began = time.perf_counter()
    for step in range(1, steps + 1):
        np.add(start, full * min(1.0, step * dt / RAMP), out=length)
        mujoco.mj_step(model, data)
        iterations += int(data.solver_niter[0])
    wall = time.perf_counter() - began
    end = plant.nodes + data.qpos.reshape(-1, 3).T
    if not np.isfinite(end).all():
        raise RuntimeError(f"MuJoCo's ramp came apart at a time step of {dt:g} s")
    return Ramp(end, wall, steps, iterations / steps, float(-end[2].min()))


def pose_error(end: Floats, converged: Floats, start: Floats) -> float:
    """Rms distance of the nodes from `converged`, relative to how far it is from `start`; all (3, n)."""
    return float(np.linalg.norm(end - converged) / np.linalg.norm(converged - start))
