"""Public functions on unusual chains: they answer, or say in one line what they cannot do."""

import inspect
import pkgutil
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any, get_type_hints

import pytest
from helpers.example_scenes import run

import lmpchain
from lmpchain import Chain, Drive, Force, Impulse, InputError, Law, Packet, Scene, Trajectory

PLAIN: dict[str, Any] = {"grains": 12, "diameter": 1e-3}
LEVEL: dict[str, Any] = PLAIN | {"gravity": 0.0}
SPRING = Law("k*u", k=1e5)
CHAINS: dict[str, dict[str, Any]] = {
    "column": PLAIN,
    "one grain": {"grains": 1, "diameter": 1e-3, "top": "wall", "bottom": "wall"},
    "two grains": PLAIN | {"grains": 2},
    "vacuum": LEVEL,
    "free vacuum": LEVEL | {"bottom": "free"},
    "striker": LEVEL | {"top_load": 1.0, "load_grain": 2},
    "between walls": LEVEL | {"top_load": 1.0, "top": "wall", "bottom": "wall"},
    "harmonic": PLAIN | {"exponent": 1.0},
    "dimer": PLAIN | {"material": ["steel", "ptfe"] * 6, "exponent": 1.5},
    "viscous": PLAIN | {"damping": {"viscoelastic": 1e-7}},
    "drag on one grain": PLAIN | {"damping": {"drag": [0.0] * 11 + [1e4]}},
    "viscous vacuum": LEVEL | {"damping": {"viscoelastic": 1e-7}},
    "formula": PLAIN | {"law": Law("k*max(o, 0)**1.5*(1 + c*o)", c=1e4)},
    "bonds without load": LEVEL | {"law": Law("k*(exp(b*o) - 1)", k=1.0, b=1e6)},
    "spring to the ground": PLAIN | {"ground": SPRING},
    "ground that changes": PLAIN | {"ground": Law("k*(1 + sin(w*t)/2)*u", k=1e5, w=1e5)},
    "ground on one side": PLAIN | {"ground": Law("k*max(u, 0)", k=1e5)},
    "ground that pushes away": PLAIN | {"ground": Law("b*u**3 - k*u", k=1e3, b=1e20)},
    "viscous on the ground": PLAIN | {"ground": SPRING, "damping": {"viscoelastic": 1e-7}},
}
# Values of parameters without a default.
VALUES: dict[str, Any] = {
    "grain": 1,
    "contact": 1,
    "frequency": 1e4,
    "m": [1.0, 2.0],
    "time": 1e-6,
    "energy": 1e-12,
    "mode": 1,
    "quantities": ["kinetic_energy"],
    "wavenumber": [0.5],
}
ROOMS = ("measure", "measure.fit", "theory", "stability", "chain", "orbits")


def functions() -> Iterator[tuple[str, Callable[..., Any], type]]:
    """Yield the public functions whose first argument is a chain, a scene or a run."""
    for room in ROOMS:
        package = import_module(f"lmpchain.{room}")
        for info in pkgutil.iter_modules(package.__path__):
            module = import_module(f"{package.__name__}.{info.name}")
            for name, function in inspect.getmembers(module, inspect.isfunction):
                if name[0] == "_" or function.__module__ != module.__name__:
                    continue
                first = next(iter(inspect.signature(function).parameters), None)
                kind = get_type_hints(function).get(first or "")
                if kind in (Chain, Scene, Trajectory):
                    yield f"{room}.{info.name}.{name}", function, kind


def excitations(chain: Chain) -> Iterator[Any]:
    """Yield a strike, a steady push, a steady drive and a packet, if the chain takes them."""
    size = float(chain.length_scale) if chain.compressed else 1e-9
    rate = chain.band_edge or 1e5
    yield Impulse(velocity=0.1 * size * rate, grain=chain.movable)
    yield Force(grain=1, amplitude=1e-6, frequency=0.2 * rate)
    yield Drive(grain=int(chain.top == "free"), amplitude=0.1 * size, frequency=0.1 * rate)
    yield Packet(frequency=0.1 * rate, width=2.0, grain=6, amplitude=0.1 * size)


def arguments(function: Callable[..., Any]) -> dict[str, Any] | None:
    """Return values for all parameters that need one, apart from the first; None if unknown."""
    parameters = list(inspect.signature(function).parameters.values())[1:]
    needed = [p.name for p in parameters if p.default is p.empty]
    return {name: VALUES[name] for name in needed} if VALUES.keys() >= set(needed) else None


@pytest.mark.soak
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("kind", CHAINS)
def test_functions_answer_or_say_why_not(kind: str) -> None:
    """No function ends in another error than one that names a field and a remedy."""
    chain = Chain(**CHAINS[kind])
    runs: list[Trajectory] = []
    for excitation in excitations(chain):
        try:
            runs.append(run(chain, excitation, 60 / (chain.band_edge or 1e5), 1201, 1e-6))
        except InputError:
            continue
    assert runs
    for name, function, first in functions():
        given = arguments(function)
        if given is None:
            continue
        subjects: dict[type, list[Any]] = {
            Chain: [chain],
            Scene: [each.scene for each in runs],
            Trajectory: runs,
        }
        for subject in subjects[first]:
            try:
                answer = function(subject, **given)
            except (InputError, lmpchain.RunFailed):
                continue
            except Exception as error:
                raise AssertionError(f"{name}: {error!r}") from error
            repr(answer)
