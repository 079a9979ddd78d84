"""Memory layout of chains, initial windows, and weights of openings, against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck

from lmpchain import Chain, Displacement, Drive, Force, Impulse, Law, Profile
from lmpchain.integrators.batch import WINDOW_MIN, ChainBatch, force_form, name_of, series, weakest
from lmpchain.integrators.kernels.contact_forces import Form
from lmpchain.integrators.kernels.layout import (
    PAD,
)
from lmpchain.integrators.methods import METHODS, methods_of
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps

BETWEEN = {"top": "wall", "bottom": "wall", "top_material": "brass"}
N = 5


def chains(**options) -> list[Chain]:
    """Return two different chains."""
    rng = np.random.default_rng(4)
    return [
        Chain(
            **{
                "grains": N,
                "diameter": rng.uniform(1e-3, 2e-3, N),
                "gravity": 20.0,
                "top_load": 0.01,
            }
            | options
        )
        for _ in range(2)
    ]


def batch(*made: Chain, excitation=None, duration: float = 1e-5) -> ChainBatch:
    excitation = excitation or Impulse(velocity=1e-3, grain=2)
    return ChainBatch([scene_of(chain, excitation, duration, 3) for chain in made])


ENDS = {
    "walls": BETWEEN,
    "held below": {},
    "touching": {"top_load": 0.0, **BETWEEN},
    "vacuum": {"gravity": 0.0, "top_load": 0.0, **BETWEEN},
    "free vacuum": {"gravity": 0.0, "top_load": 0.0, "bottom": "free"},
}
DAMPING = {"viscoelastic": 1e-8, "drag": 1e4}


@pytest.mark.parametrize("ends", [*ENDS, "loose grains", "damped"])
def test_units_are_those_of_the_first_compressed_contact_below_grain_1(ends: str):
    others = {
        "loose grains": {"gravity": 0.0, "load_grain": 3},
        "damped": {"damping": DAMPING},
    }
    made = chains(**(ENDS | others)[ends])
    laid = batch(*made)
    for chain, (length, speed), allowed, scene in zip(
        made, laid.arrays.units, laid.arrays.allowed, laid.scenes, strict=True
    ):
        contacts = chain.contacts
        below = 3 if ends == "loose grains" else 1
        overlap = 1.0 if "vacuum" in ends else contacts.overlap[below]
        rate = np.sqrt(contacts.stiffness[below] / chain.masses[0])
        if "vacuum" not in ends:
            assert length == pytest.approx(overlap, rel=1e-15)
        assert speed == pytest.approx(length * rate, rel=1e-14)
        slow = chain.masses.sum() * (1e-3 * speed) ** 2
        if chain.damped:  # Reduced velocities are rounded.
            slow += chain.masses.sum() * (1e-6 * scene.imposed[1]) ** 2
        assert allowed == pytest.approx(3 * scene.energy + slow, rel=1e-13)


def test_units_of_a_single_grain_are_those_of_the_contact_above():
    chain = column(1, gravity=0.0, top_load=1.0, top="wall", bottom="wall")
    laid = batch(chain, excitation=Impulse(velocity=1e-3))
    assert laid.arrays.units[0, 0] in (chain.contacts.overlap[0], chain.contacts.overlap[1])


@pytest.mark.parametrize(
    "excitation",
    [
        Impulse(velocity=3e-3, grain=2),
        Displacement(displacement=-2e-8, grain=2),
        Drive(amplitude=2e-8, frequency=2e4),
        Drive(amplitude=2e-8, frequency=2e6),
    ],
)
def test_scales_are_the_largest_speed_and_displacement_of_the_excitation(excitation):
    chain = chains()[0]
    laid = batch(chain, excitation=excitation)
    scene = laid.scenes[0]
    farthest, fastest = scene.imposed
    speed = max(fastest, farthest * scene.highest_frequency)
    assert laid.arrays.omega[0] == scene.highest_frequency
    assert laid.arrays.scale[0] == pytest.approx(
        [speed / scene.highest_frequency, speed], rel=1e-14
    )


def test_rows_begin_at_cache_lines_with_one_body_more_at_either_end():
    for grains in (7, 8, 9, 15, 16, 17):
        laid = batch(column(grains))
        x, v, _ = laid.place(*(field[None] for field in laid.initial))
        width = -(-(grains + 2 * PAD) // PAD) * PAD
        for rows in (x, v, laid.arrays.strength, laid.arrays.inverse_mass):
            assert rows.shape[1] == width
            assert rows.ctypes.data % 64 == 0


PLACES = {
    "grain 1": (Impulse(velocity=1e-3), 1, 1),
    "grain 100": (Impulse(velocity=1e-3, grain=100), 100, 100),
    "the last": (Impulse(velocity=1e-3, grain=299), 299, 299),
    "a force": (Force(amplitude=1e-3, frequency=1e4, grain=77), 77, 77),
    "the wall": (Drive(amplitude=1e-9, frequency=1e4, grain=0), 1, 1),
}


@pytest.mark.parametrize("what", PLACES)
def test_the_initial_window_surrounds_the_excitation(what: str):
    """Windows begin at whole cache lines and include driven grains."""
    excitation, low, high = PLACES[what]
    laid = batch(column(300, top="wall", top_load=1e-3), excitation=excitation)
    _, _, state = laid.place(*(field[None] for field in laid.initial))
    first = state["first"][0]
    last = state["last"][0]
    assert first % PAD == last % PAD == 0
    assert PAD <= first <= PAD - 1 + low < first + 2 * PAD
    assert last - 2 * PAD <= PAD - 1 + high < last


def test_moving_grains_set_the_window_without_speeds_of_driven_grains():
    chain = column(300)
    u, v = np.zeros((2, 300))
    u[120] = 1e-9
    v[170] = 1e-3
    laid = batch(chain, excitation=Profile(displacement=u, velocity=v))
    x, w, state = laid.place(*(field[None] for field in laid.initial), 3)
    assert x.shape[0] == 3
    assert np.array_equal(x[:, PAD : PAD + 300], np.tile(u, (3, 1)))
    assert np.array_equal(w[:, PAD : PAD + 300], np.tile(v, (3, 1)))
    assert (state["first"] == 128).all()
    assert (state["last"] == 184).all()
    driven = batch(chain, excitation=Drive(amplitude=1e-9, frequency=1e4))
    _, w, _ = driven.place(*(field[None] for field in driven.initial))
    assert driven.initial[1][0, 0] > 0
    assert not w.any()


def test_short_chains_are_computed_as_a_whole():
    for grains in (WINDOW_MIN - 2 * PAD, WINDOW_MIN - 2 * PAD + 1):
        laid = batch(column(grains))
        x, _, state = laid.place(*(field[None] for field in laid.initial))
        whole = [PAD, x.shape[1] - PAD]
        assert ([state["first"][0], state["last"][0]] == whole) == (grains == WINDOW_MIN - 2 * PAD)


@pytest.mark.parametrize("ends", ENDS)
def test_contacts_that_are_open_at_rest_are_marked(ends: str):
    laid = batch(*chains(**ENDS[ends]))
    _, _, state = laid.place(*(field[None] for field in laid.initial))
    assert (state["least_strain"] == (0.0 if ends in ("walls", "held below") else -1.0)).all()


def test_batches_of_splines_of_any_length_move_like_single_chains(rng):
    """The longest spline sets the number of knots; forces act on different grains."""
    chain = chains(**BETWEEN)[0]
    scenes = []
    for grain, count in ((2, 4), (5, 9), (1, 6)):
        force = Force(
            times=np.linspace(0, 4e-5, count), force=0.1 * rng.normal(size=count), grain=grain
        )
        scenes.append(scene_of(chain, force, 4e-5, 5))
    together = np.zeros((2, 3, 5, N))
    for name in ("rkn4", "dop853", "gear4"):
        schedule = Steps(9, 1, 1e-5 / 9, False)
        NativeStepper(ChainBatch(scenes), METHODS[name], schedule, {}).fill(*together, 0, 4, 2**62)
        for number, scene in enumerate(scenes):
            alone = np.zeros((2, 1, 5, N))
            NativeStepper(ChainBatch([scene]), METHODS[name], schedule, {}).fill(
                *alone, 0, 4, 2**62
            )
            assert np.array_equal(together[:, number, 1:], alone[:, 0, 1:])
            assert alone[:, 0, 1:].any()


def form_of(force: str = "auto", strikes: float = 1.0, **options) -> int:
    chain = Chain(**{"grains": N, "diameter": 1e-3} | options)
    speed = strikes * chain.length_scale / chain.time_scale if chain.compressed else strikes
    return force_form(struck(chain, speed, 1e-5), force)


def test_the_fastest_accurate_form_is_chosen():
    """Cases are on both sides of strike number 1, and of the strain limit of the series."""
    assert form_of(strikes=1.01) == 6
    assert form_of(strikes=0.99) == Form.CORRECTED
    assert form_of("exact", strikes=1.01) == Form.CORRECTED
    assert form_of("plain", strikes=0.99) == 6
    assert form_of("plain", strikes=1e-9) == 6
    assert form_of(strikes=1e-4) == Form.POLYNOMIAL
    assert form_of("exact", strikes=1e-4) == Form.CORRECTED
    for delta, form in ((1.25, 5), (1.75, 7), (2.0, 8)):
        assert form_of(strikes=1.01, exponent=delta) == form
        assert form_of(strikes=0.99, exponent=delta) == Form.POWER
        assert form_of(gravity=0.0, exponent=delta) == form
    assert form_of(strikes=9.0, exponent=2.25) == form_of("plain", exponent=2.25) == Form.POWER
    assert (
        form_of(gravity=0.0, exponent=2.25)
        == form_of("exact", gravity=0.0, exponent=1.3)
        == Form.UNCOMPRESSED_POWER
    )
    assert form_of(exponent=1.0) == form_of(exponent=1.0, gravity=0.0) == Form.SPRING
    assert [name_of(form) for form in (*Form, 6)] == [
        "corrected square root", "polynomial", "spring", "vectorised power", "vectorised power",
        "formulas", "plain square roots",
    ]  # fmt: skip


def test_a_series_is_chosen_up_to_the_strain_of_its_rounding_error():
    chain = column(N)
    scene = struck(chain, 1e-6, 1e-5)
    limit = 1e-6 * weakest(1.5) / scene.largest_strain  # Strains are proportional to the speed.
    for factor, form in ((0.99, Form.POLYNOMIAL), (1.01, Form.CORRECTED)):
        assert force_form(scene.replace(excitation=Impulse(velocity=factor * limit))) == form


def test_binomial_coefficients():
    for delta in (1.25, 1.5, 2.0, 2.7):
        expected = []
        term = 1.0
        for k in range(7):
            term *= (delta - k) / (k + 1)
            expected.append(term)
        assert series(delta).tolist() == pytest.approx([*expected, delta], rel=1e-14)
        eighth = abs(term * (delta - 7) / 8)
        most = weakest(delta)
        assert most == 0.02 or eighth * most**7 == pytest.approx(1e-16 * delta, rel=1e-10)
        assert eighth * most**7 <= 1.0001e-16 * delta
    assert weakest(2.0) == 0.02
    assert weakest(1.5) > 0.01


def test_the_plain_form_is_inaccurate_only_for_compressed_contacts():
    pressed = struck(column(N), 0.1, 1e-5)
    vacuum = pressed.replace(chain=pressed.chain.replace(gravity=0.0))
    weak = pressed.replace(excitation=Impulse(velocity=1e-6))
    assert ChainBatch([pressed, weak]).plain == [True, False]
    assert ChainBatch([vacuum]).plain == [False]
    assert ChainBatch([pressed]).opening_power == 1.5


EXTREMES = [
    (name, grain, {}) for name in ("verlet", "rkn6", "dop853", "gear4") for grain in (None, 0, 1)
] + [(name, None, {"damping": DAMPING}) for name in ("verlet", "dop853", "lagged-verlet")]
EXTREMES += [("rkn6", None, {"bottom": "wall"})]


@pytest.mark.parametrize(("name", "grain", "options"), EXTREMES)
def test_extremes_include_all_steps(
    rng: np.random.Generator, name: str, grain: int | None, options: dict
):
    """Smallest overlap, nearest approach and largest motion agree with samples at every step.

    Grains fly, or the top wall or grain 1 is driven. A free top has no contact.
    """
    chain = chains(**options if "bottom" in options else BETWEEN | options)[0]
    u, v = rng.uniform(-1, 1, (2, N))
    scale = chain.contacts.overlap.max()
    edge = chain.band_edge
    u, v = scale * u, scale * edge * v
    excitation: Profile | Drive = Profile(displacement=u, velocity=v)
    if grain is not None:
        # The driven body is faster than all others.
        u[:grain] = v[:grain] = 0.0
        start = Profile(displacement=0.1 * u, velocity=0.1 * v)
        excitation = Drive(amplitude=scale, frequency=0.2 * edge, grain=grain, start=start)
    scene = scene_of(chain, excitation, 20 / edge, 201)
    method = methods_of(chain)[name]
    stepper = NativeStepper(ChainBatch([scene]), method, Steps(1, 1, 0.1 / edge, False), {})
    fields = np.zeros((2, 1, 201, N))
    stepper.fill(*fields, 0, 200, 2**62)
    fields[:, 0, 0] = scene.initial()
    wall = excitation.wall.at(scene.time) if excitation.wall else None
    begin = int(chain.top == "free")
    closer = chain.contacts.closer(fields[0, 0], wall)[:, begin:]
    skipped = 0 if name in ("rkn6", "verlet") else 1
    state = stepper.watched[0]
    late = slice(skipped, None)
    assert state["least_strain"] == pytest.approx(
        (closer[late] / chain.contacts.overlap[begin:]).min(), rel=0.01
    )
    assert state["largest_approach"] == pytest.approx(closer[late].max(), rel=0.01)
    assert stepper.closest()[0, 0] == state["largest_approach"]
    farthest, fastest = (np.abs(field).max() for field in fields)
    assert 0.9 * farthest < state["largest_displacement"] <= farthest * (1 + 1e-12)
    assert 0.85 * fastest < state["largest_speed"] < 1.01 * fastest
    assert stepper.largest()[0].tolist() == [state["largest_displacement"], state["largest_speed"]]


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.2])
@pytest.mark.parametrize("ends", ENDS)
def test_weights_of_openings_are_ratios_of_accelerations(ends, exponent):
    made = chains(**ENDS[ends], exponent=exponent)
    laid = batch(*made)
    # A power has one kink a contact.
    weight, reach = laid.arrays.opening_weight[:, 0], laid.arrays.opening_reach[:, 0]
    for real, chain in enumerate(made):
        contacts = chain.contacts
        omega = laid.arrays.omega[real]
        lightest = np.append(
            0, np.append(1 / chain.masses[: chain.movable], np.zeros(N + 1 - chain.movable))
        )
        mobility = np.maximum(lightest[:-1], lightest[1:])
        pull = (contacts.constant if "vacuum" in ends else contacts.force).copy()
        pull[0] = contacts.constant[0] if ends == "touching" else pull[0]
        length = np.ones(N + 1) if "vacuum" in ends else contacts.overlap.copy()
        length[0] = 1.0 if ends == "touching" else length[0]
        strain = np.divide(laid.arrays.scale[real, 0], length, out=np.ones(N + 1), where=length > 0)
        pull = pull * strain ** (exponent - 1.5)
        expected = (pull * mobility / (omega**2.5 * laid.arrays.scale[real, 1])) ** 2
        assert weight[real, PAD - 1 : PAD + N] == pytest.approx(expected, rel=1e-13)
        assert not np.delete(weight[real], np.arange(PAD - 1, PAD + N)).any()
        slow = np.sqrt(2) * (2 * omega) ** 3
        assert reach[real] == pytest.approx(np.cbrt(weight[real]) / slow, rel=1e-13)


LAWS = {
    # The slope of the force jumps at the first kink, its curvature at the second one.
    "two kinks": (
        Law("k*o + q*max(o - e, 0) + p*max(o - d, 0)**2", k=1e5, q=3e4, e=1e-7, p=1e12, d=9e-7),
        [1e-7, 9e-7],
        lambda length: np.array([3e4 * length, 1e12 * length**2]),
    ),
    # The bend is odd, and counts twice.
    "odd": (
        Law("k*o + p*(o - d)*abs(o - d) + p*d**2", k=1e5, p=1e12, d=9e-7),
        [9e-7],
        lambda length: np.array([2e12 * length**2]),
    ),
}


@pytest.mark.parametrize("name", LAWS)
def test_every_kink_of_a_formula_has_its_distance_and_weight(name: str):
    law, places, bend = LAWS[name]
    made = chains(law=law, top_load=0.05, gravity=0.0)
    laid = batch(*made, excitation=Impulse(velocity=1e-6))
    arrays = laid.arrays
    inside = slice(PAD, PAD + N - 1)
    for real, chain in enumerate(made):
        omega = arrays.omega[real]
        typical, speed = arrays.scale[real]
        mobility = np.maximum(1 / chain.masses[:-1], np.append(1 / chain.masses[1 : N - 1], 0))
        apart = chain.equilibrium_overlap[:, None] - places
        assert typical < 1e-3 * np.abs(apart).min()
        bent = bend(typical)
        changes = omega**2.5 * speed
        expected = (bent * (typical / np.abs(apart)) ** -1.5 * mobility[:, None] / changes) ** 2
        order = np.argsort(-1 / arrays.opening_length[real, :, PAD + 1])
        distances = 1 / arrays.opening_length[real, order, inside].T
        assert distances == pytest.approx(apart, rel=1e-12)
        weights = arrays.opening_weight[real, order, inside].T
        # The bend is a difference of forces, which are rounded.
        assert weights == pytest.approx(expected, rel=1e-3)
        reach = np.cbrt(arrays.opening_weight[real]) / (np.sqrt(2) * (2 * omega) ** 3)
        assert arrays.opening_reach[real] == pytest.approx(reach, rel=1e-13)
        nearest = np.take_along_axis(apart, np.abs(apart).argmin(1)[:, None], 1)[:, 0]
        assert 1 / arrays.inverse_length[real, inside] == pytest.approx(nearest, rel=1e-12)
        # Contacts of several kinks count as open.
        assert arrays.least_strain[real] == (-1 if len(places) > 1 else 0)
    assert arrays.opening_rest == 1


def test_a_formula_without_a_kink_shortens_no_step():
    smooth = batch(*chains(law=Law("k*o", k=1e5), bottom="fixed")).arrays
    assert not smooth.opening_weight.any()
    assert not smooth.inverse_length.any()
    assert not smooth.least_strain.any()


# Laws with a kink that some contacts or grains do not have.
CONTACT = "k*o + c*o**5 + q*max(s*o - e, 0)"
GROUND = "k*u + c*u**5 + q*max(s*u - e, 0)"
NUMBERS = {"k": 1e5, "q": 1e5, "c": 1e20}


def test_all_grains_on_a_ground_are_in_the_window():
    laid = batch(column(300, ground=Law("k*u", k=1.0)))
    _, _, state = laid.place(*(field[None] for field in laid.initial))
    assert (state["first"][0], state["last"][0]) == (PAD, PAD + 304)
    # All contacts are closed, and the force from the ground has no kink.
    assert state["least_strain"][0] == 0


@pytest.mark.parametrize(
    "options",
    [
        {"ground": Law(GROUND, **NUMBERS, s=1, e=[1e-7, 2e-7, 3e-7, 1e-7, 1e-7])},
        {"law": Law(CONTACT, **NUMBERS, s=[0, 1, 1, 1], e=1e-7), "gravity": 0.0},
        {"gravity": 0.0, "load_grain": 3, "damping": {"viscoelastic": 1e-8, "drag": 2.0}},
    ],
    ids=["ground", "formula", "loose grains"],
)
def test_a_batch_consists_of_the_rows_of_its_chains(options):
    first, second = chains(**options)
    ground = Law(GROUND, **NUMBERS, s=2, e=3e-7)
    made = [first, second.replace(ground=ground) if "ground" in options else second]
    force = Force(times=[0.0, 1e-6, 4e-6], force=[0.0, 1.0, 0.5], grain=3)
    together = batch(*made, excitation=force).arrays
    for real, chain in enumerate(made):
        alone = batch(chain, excitation=force).arrays
        for name, rows in together._asdict().items():
            if np.ndim(rows) and name not in ("laws", "coefficients"):
                assert np.array_equal(rows[real], getattr(alone, name)[0]), name
    assert not np.array_equal(together.inverse_mass[0], together.inverse_mass[1])


@pytest.mark.filterwarnings("error")
def test_a_kink_that_no_motion_reaches_has_no_weight():
    """The contacts or grains with s = 0 have none; there the force at the kink is infinite."""
    law = Law(CONTACT, **NUMBERS, s=[0, 1, 1, 1], e=1e-7)
    (weights,) = batch(column(N, gravity=0.0, law=law)).arrays.opening_weight[0]
    assert (weights[PAD : PAD + N - 1] > 0).tolist() == [False, True, True, True]
    law = Law(GROUND, **NUMBERS, s=[0, 1, 1, 1, 1], e=1e-7)
    arrays = batch(column(N, ground=law)).arrays
    assert arrays.least_strain[0] == -1
    (weights,) = arrays.ground_kinks[0, 1]
    # The last grain is fixed.
    assert (weights[PAD : PAD + N] > 0).tolist() == [False, True, True, True, False]
