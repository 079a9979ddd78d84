"""The parts of the theory come when they are asked for."""

from importlib import import_module

import pytest

import lmpchain


@pytest.mark.parametrize("name", ["bessel", "continuum", "dyson", "front", "modes"])
def test_parts_resolve(name: str):
    assert getattr(lmpchain.theory, name) is import_module(f"lmpchain.theory.{name}")
    assert name in dir(lmpchain.theory)


def test_nothing_else_resolves():
    with pytest.raises(AttributeError, match="has no attribute 'modal'"):
        _ = lmpchain.theory.modal
