"""From a checked scenario to what is simulated: body, field, model, first state and programme."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from gelbot.body.lattice import Body, build_body
from gelbot.body.quadratic import with_midpoints
from gelbot.body.symmetry import rotation
from gelbot.control.programme import Playing, Programme, begin
from gelbot.field.charge import FieldSolution, build_problem, in_solution, solve
from gelbot.field.circuit import connection
from gelbot.field.electrodes import ElectrodeArray
from gelbot.field.gel import disturbance, gel_panels
from gelbot.field.images import Tank
from gelbot.field.lead_field import build_lead_field, table_error
from gelbot.mechanics.beam import bending_modulus
from gelbot.mechanics.contact import resting_depth
from gelbot.mechanics.dissection import Dissection, dissect
from gelbot.mechanics.elastic import Elastic, node_pairs
from gelbot.mechanics.implicit import Mechanics
from gelbot.mechanics.medium import net_weight
from gelbot.mechanics.self_contact import ContactSurface, contact_surface
from gelbot.mechanics.solid import build_solid
from gelbot.mechanics.springs import build_lattice
from gelbot.points import essential_points, observe
from gelbot.scenario.motions import check_tips
from gelbot.scenario.placement import mounted
from gelbot.scenario.programme_arrays import build_programme
from gelbot.scenario.schema import Scenario
from gelbot.scenario.surroundings import check_free, obstacles
from gelbot.simulate import Gel, Model, State, face_geometry, start

WORKING_REACH = 2.2
"""The lead field is tabulated this many reaches of the body around its place, about as far as it can roll."""
HEADROOM = 3e-3
"""The table ends this far [m] below the plates, where there is room: nearer, their edges would need a finer grid."""
CONTACT_LAYER = 0.01
"""Share of the thickness within which the force of a surface builds up."""
OWN_LAYER = 0.05
"""The same where the body meets itself: corners of the mesh that slide past each other need a rounder way."""
FIRM_WEIGHTS, FIRM_STRESS = 10.0, 0.01
"""A node pressed with this many weights of the body plus this share of E h^2 comes to the surface itself (gap 0), one
pressed with three times as much sinks in by a `CONTACT_LAYER`."""
LOOK_AHEAD = 0.2
"""Parts of the body nearer than this share of the thickness are watched: they may meet."""
STICK_SPEED = 2e-6
"""Creep [m/s] below which friction sticks: 0.1 mm in a minute under a load just short of slipping."""
LIGHTEST = 0.02
"""A body whose density nearly equals the solution's has no weight to measure residuals by: at least this share."""


@dataclass(frozen=True)
class Experiment:
    """A scenario made ready: `model`, first `state`, `programme`, and what they were made of.

    `connection`, shape (e, e), takes the voltages asked for to those that the electrodes have (`field.circuit`).
    `table_error`: of the lead field's table on the body's faces at the start, relative to the largest current density.
    """

    scenario: Scenario
    body: Body
    array: ElectrodeArray
    field: FieldSolution
    connection: NDArray[np.float64]
    table_error: float
    model: Model
    state: State
    programme: Programme


def build(scenario: Scenario, base: Experiment | None = None) -> Experiment:
    """Make everything that `scenario` describes; arrays in its precision. Raises `BadInput` for a mesh too coarse.

    What it has in common with `base`, such as the body's mesh and the electrodes' field, is taken from there: robots
    that differ in their material take milliseconds instead of seconds.
    """
    kept = _kept(scenario, base)
    body = build_mesh(scenario) if kept.body is None else kept.body.body
    if kept.field is None:
        array, panels = electrode_array(scenario), scenario.electrodes.panels_used
        field = solve(build_problem(array, field_tank(scenario), scenario.solution.conductivity, panels))
        connected = connection(field.conductance, scenario.electrodes.states)
    else:
        array, connected = kept.field.array, kept.field.connection
        field = in_solution(kept.field.field, scenario.solution.conductivity)
    dtype = jnp.dtype(scenario.simulation.precision)

    def cast(tree):
        return jax.tree.map(
            lambda a: jnp.asarray(a, dtype if jnp.issubdtype(jnp.result_type(a), jnp.floating) else None), tree
        )

    dissection = None if kept.body is None else kept.body.model.mechanics.dissection
    mechanics = build_mechanics(scenario, body, dissection=dissection)
    positions = sunk(mechanics, posed(scenario, body))
    check_free(mechanics.obstacles, positions)
    if kept.table is None:
        low, high = working_box(scenario, body, array)
        lead = build_lead_field(field, low, high, scenario.simulation.field_spacing, connected)
        centroids = face_geometry(jnp.asarray(positions), jnp.asarray(body.faces))[0]
        error = table_error(lead, field, centroids, connected)
    else:
        lead, error = kept.table.model.lead, kept.table.table_error
        lead = lead._replace(conductivity=jnp.asarray(scenario.solution.conductivity))
    check_tips(scenario.motion, len(body.tips))
    points = essential_points(body) if kept.body is None else kept.body.model.points
    model = Model(build_gel(scenario, body), mechanics, lead, points)
    model, positions = cast(model), cast(positions)
    state = start(model, positions)
    if kept.programme is not None:
        programme = kept.programme.programme
    else:
        programme = cast(build_programme(scenario, field, connected, len(body.tips)))
    return Experiment(scenario, body, array, field, connected, error, model, state, programme)


class _Kept(NamedTuple):
    """What an experiment has in common with another one: that one, or None where they differ."""

    body: Experiment | None
    field: Experiment | None
    table: Experiment | None
    programme: Experiment | None


def _kept(scenario: Scenario, base: Experiment | None) -> _Kept:
    if base is None or base.scenario.simulation.precision != scenario.simulation.precision:
        return _Kept(None, None, None, None)
    old = base.scenario

    def sheet(s: Scenario) -> object:
        return s.body.model_copy(update={"pose": None}), s.material.model

    def tank(s: Scenario) -> object:
        return s.electrodes, s.tank.model_copy(update={"friction": None})

    def box(s: Scenario) -> object:
        return s.place, s.body.pose.lift, s.simulation.field_spacing

    def played(s: Scenario) -> object:
        return s.supply, s.programme.model_copy(update={"place": s.place})

    body = base if sheet(old) == sheet(scenario) else None
    field = base if tank(old) == tank(scenario) else None
    table = base if body and field and box(old) == box(scenario) else None
    return _Kept(body, field, table, base if table and played(old) == played(scenario) else None)


def build_mesh(scenario: Scenario) -> Body:
    """The body's mesh, as its material needs it."""
    sheet = scenario.body
    body = build_body(sheet.outline(), sheet.thickness, sheet.mesh_size, sheet.layers)
    return with_midpoints(body) if scenario.material.model == "solid" else body


def begun(experiment: Experiment, state: State) -> Playing:
    """The programme at its beginning, for the robot that is in `state`: the memory of `control.programme.play`."""
    return Playing(experiment.programme, begin(experiment.programme, observe(experiment.model.points, state.positions)))


def electrode_array(scenario: Scenario) -> ElectrodeArray:
    """The electrodes of `scenario`, for the field: a plate in a wall of the tank has no other back."""
    return mounted(scenario.electrodes.array, scenario.tank)


def disturbed(experiment: Experiment, model: Model, positions: jax.Array) -> Model:
    """`model` with the field as a gel of its own conductivity, now at `positions` (3, n) [m], disturbs it.

    Unchanged where the scenario gives the gel no conductivity.
    """
    conductivity, field = experiment.scenario.material.conductivity, experiment.field
    if conductivity is None:
        return model
    faces = experiment.body.faces
    gel = gel_panels(np.asarray(positions, float), faces, conductivity, field.problem.conductivity)
    change = disturbance(field, gel) @ experiment.connection
    return model._replace(disturbance=jnp.asarray(change, positions.dtype))


def field_tank(scenario: Scenario) -> Tank:
    """The boundaries of the solution that let no current through."""
    tank = scenario.tank
    floor = None if "floor" in tank.open else -tank.floor_depth
    x_low, x_high, y_low, y_high = (side not in tank.open for side in ("-x", "+x", "-y", "+y"))
    surface = None if "surface" in tank.open else tank.depth
    return Tank(floor, surface, tank.size, (x_low, x_high, y_low, y_high))


def posed(scenario: Scenario, body: Body) -> NDArray[np.float64]:
    """Node positions at the start [m], shape (3, n); the body lies on the floor's contact layer."""
    pose = scenario.body.pose
    flat = rotation(pose.heading) @ body.nodes[:2] + np.array(pose.position)[:, None]
    return np.vstack([flat, body.nodes[2] + pose.lift + CONTACT_LAYER * body.thickness])


def sunk(mech: Mechanics, positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """A body that has been laid on the floor's contact layer, so deep in it that it rests there.

    Otherwise it would begin with a fall that one cannot see, and that costs as much as a minute's rest.
    """
    lying = positions[2] <= mech.contact_layer * (1.0 + 1e-9)
    if not lying.any():
        return positions
    load = jnp.sum(mech.weight) / lying.sum()
    depth = float(resting_depth(load, mech.contact_stiffness, mech.contact_layer))
    return positions - np.array([[0.0], [0.0], [depth]])


def build_gel(scenario: Scenario, body: Body) -> Gel:
    """The active surface of the body."""
    material = scenario.material
    return Gel(
        faces=jnp.asarray(body.faces),
        p_ele=jnp.asarray(material.p_ele),
        p_ads=jnp.asarray(material.p_ads),
        p_l=jnp.asarray(material.p_l),
        adsorption_step=jnp.asarray(material.adsorption_step),
    )


def working_box(
    scenario: Scenario, body: Body, array: ElectrodeArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest corner [m], shape (3,) each, of the box in which the lead field is tabulated."""
    place, reach = np.array(scenario.place), WORKING_REACH * body.outline.reach
    top = scenario.body.pose.lift + body.thickness
    low, high = place - reach, place + reach
    # Only electrodes over the box bound it; without them the body may roll as high as it may roll far.
    over = [
        e.bounds[0][2] for e in array.electrodes if np.all(e.bounds[0][:2] < high) and np.all(e.bounds[1][:2] > low)
    ]
    lowest = min((float(z) for z in over if z > top), default=None)
    if lowest is None:
        ceiling = min(scenario.tank.depth or np.inf, top + reach)
    else:
        ceiling = lowest - min(HEADROOM, (lowest - top) / 4.0)
    return np.array([*low, 0.0]), np.array([*high, ceiling])


def build_mechanics(
    scenario: Scenario, body: Body, elastic: Elastic | None = None, dissection: Dissection | None = None
) -> Mechanics:
    """Stiffness, masses, weights and contact of the body in its solution; of the scenario's material, or `elastic`.

    The `dissection` of the same body may be given, it takes longest.
    """
    material, solution, simulation = scenario.material, scenario.solution, scenario.simulation
    weight = net_weight(body.node_volume, material.density, solution.density)
    heaviest = np.maximum(np.abs(weight), LIGHTEST * net_weight(body.node_volume, material.density, 0.0))
    layer = CONTACT_LAYER * body.thickness
    firm = FIRM_WEIGHTS * heaviest.sum() + FIRM_STRESS * material.young_modulus * body.thickness**2
    elastic = build_elastic(scenario, body) if elastic is None else elastic
    own_friction = scenario.tank.friction if material.self_friction is None else material.self_friction
    return Mechanics(
        elastic=elastic,
        dissection=dissect(body.nodes, np.asarray(node_pairs(elastic))) if dissection is None else dissection,
        node_mass=jnp.asarray(material.density * body.node_volume),
        weight=jnp.asarray(weight),
        obstacles=obstacles(scenario),
        surface=build_surface(scenario, body) if material.self_contact else None,
        self_friction=jnp.asarray(own_friction),
        contact_stiffness=jnp.asarray(2.0 * firm / layer),
        contact_layer=jnp.asarray(layer),
        stick_speed=jnp.asarray(STICK_SPEED),
        drag=jnp.asarray(solution.drag),
        tolerance=jnp.asarray(simulation.tolerance),
        max_iterations=jnp.asarray(simulation.max_iterations),
        force_scale=jnp.asarray(np.linalg.norm(heaviest)),
    )


def build_elastic(scenario: Scenario, body: Body) -> Elastic:
    """The lattice or the solid that `material.model` names."""
    material = scenario.material
    if material.model == "solid":
        return build_solid(body, material.young_modulus, material.poisson_ratio)
    bending = bending_modulus(body.thickness, scenario.body.mesh_size, body.layer_count)
    return build_lattice(body, material.young_modulus, bending)


def build_surface(scenario: Scenario, body: Body) -> ContactSurface:
    """The surface by which the body meets itself."""
    layer = OWN_LAYER * body.thickness
    corners = int(body.faces.max()) + 1
    return contact_surface(
        body.faces, body.nodes[:, :corners], body.thickness, scenario.body.mesh_size, layer, LOOK_AHEAD * body.thickness
    )
