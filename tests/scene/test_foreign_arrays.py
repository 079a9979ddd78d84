"""Values from other libraries are accepted as numbers, or rejected with the field's name."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray

from lmpchain import Chain, Drive, Force, Impulse, InputError, Profile, Scene, simulate
from lmpchain.chain.patterns import periodic
from lmpchain.design import Momentum, Traces, optimise
from lmpchain.disorder.transfer_matrix import lyapunov
from lmpchain.measure.contact import contacts
from lmpchain.measure.fit.inverse import Trace
from lmpchain.measure.flight import arrival
from lmpchain.theory import dyson
from lmpchain.theory.domain import chi

TIMES = [0.0, 1e-5, 2e-5]
CHAIN = Chain(grains=3, diameter=1e-3)
LOADED = Chain(grains=3, diameter=1e-3, gravity=0, top_load=1, top="wall")
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=1e-4), duration=1e-5, samples=3)
# Three values with another meaning, which numpy converts to 1, 2 and 3.
FOREIGN: dict[str, Any] = {
    "masked": np.ma.array([1.0, 2.0, 3.0], mask=[False, True, False]),
    "text": np.array(["1", "2", "3"]),
    "truth": [True, 2.0, 3.0],
    "spans": np.array([1, 2, 3], dtype="m8[us]"),
    "complex": np.array([1.0, 2.0, 3.0 + 1j]),
    "unit": xarray.DataArray([1.0, 2.0, 3.0], attrs={"units": "cm"}),
}
FIELDS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "times of a force": ("times", lambda x: Force(times=x, force=TIMES)),
    "force": ("force", lambda x: Force(times=TIMES, force=x)),
    "motion": ("displacement", lambda x: Drive(times=TIMES, displacement=x)),
    "profile": ("velocity", lambda x: Profile(velocity=x)),
    "diameters": ("diameter", lambda x: Chain(grains=3, diameter=x)),
    "masses": ("masses", lambda x: Chain(grains=3, diameter=1e-3, masses=x)),
    "constants": ("contact_constants", lambda x: CHAIN.replace(contact_constants=x)),
    "walls": ("wall_constants", lambda x: LOADED.replace(wall_constants=x)),
    "pattern": ("diameters", lambda x: periodic(9, x)),
    "grains": ("grains", lambda x: SCENE.replace(grains=x)),
    "trace": ("values", lambda x: Trace(TIMES, 1, x)),
    "times of a trace": ("time", lambda x: Trace(x, 1, TIMES)),
    "traces": ("values", lambda x: Traces(TIMES, [1], x)),
    "noise": ("noise", lambda x: Traces(TIMES, [1], TIMES, noise=x)),
    "places": ("places", lambda x: Traces(TIMES, x, np.ones((3, 3)))),
    "bounds": ("bounds", lambda x: optimise(SCENE, Momentum([2]), ["masses"], {"masses": (0, x)})),
    "signal": ("values", lambda x: arrival(TIMES, x)),
    "depth": ("h", chi),
    "stiffness": ("kappa", lambda x: dyson.average([1.0, 1.0, 1.0], x, 5)),
    "frequency": ("frequency", lyapunov),
    "contacts": ("numbers", lambda x: contacts(simulate(SCENE), x)),
}


@pytest.mark.parametrize("kind", FOREIGN)
@pytest.mark.parametrize("field", FIELDS)
def test_values_other_than_numbers_are_rejected_with_the_field(field: str, kind: str):
    name, take = FIELDS[field]
    with pytest.raises(InputError, match=f"^{name}: (must be|has a unit|has masked)") as refusal:
        take(FOREIGN[kind])
    assert len(str(refusal.value).splitlines()) == 1


def test_a_number_with_a_unit_is_rejected_with_the_remedy():
    length = xarray.DataArray(5.0, attrs={"units": "mm"})
    with pytest.raises(InputError, match=r"^velocity: has a unit of its own, mm: convert it"):
        Impulse(velocity=length)


@pytest.mark.parametrize(
    "take",
    [
        lambda: simulate(SCENE, "native", adaptive="no"),
        lambda: simulate(SCENE, adaptive="no"),
        lambda: Traces(TIMES, [1], TIMES, gain="no"),
        lambda: simulate(SCENE, progress="no"),
        lambda: optimise(SCENE, Momentum([2]), ["masses"], {"masses": (1, 2)}, maximise="no"),
        lambda: dyson.average([1.0], [1.0], 5, normalised="no"),
    ],
)
def test_the_text_no_is_not_true(take: Callable[[], Any]):
    with pytest.raises(InputError, match=r": must be True or False \(got 'no'\)"):
        take()
