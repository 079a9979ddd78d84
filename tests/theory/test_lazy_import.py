"""Modules of the theory are imported on first use."""

from importlib import import_module

import pytest

import lmpchain


@pytest.mark.parametrize(
    "name",
    [
        "bessel",
        "continuum",
        "dyson",
        "front",
        "modes",
        "bands",
        "scattering",
        "soliton",
        "dimer_soliton",
    ],
)
def test_modules_of_theory_come_on_access(name: str):
    assert getattr(lmpchain.theory, name) is import_module(f"lmpchain.theory.{name}")
    assert name in dir(lmpchain.theory)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'modal'"):
        _ = lmpchain.theory.modal
