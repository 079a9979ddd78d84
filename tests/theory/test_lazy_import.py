"""Modules of the theory are imported on first use."""

from importlib import import_module

import pytest

import lmpchain


def test_modules_of_theory_come_on_access():
    for name in ("bessel", "dyson", "bands", "dimer_soliton"):
        assert getattr(lmpchain.theory, name) is import_module(f"lmpchain.theory.{name}")
        assert name in dir(lmpchain.theory)
    with pytest.raises(AttributeError, match="has no attribute 'modal'"):
        _ = lmpchain.theory.modal
