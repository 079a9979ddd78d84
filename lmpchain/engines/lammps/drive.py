"""Drives and forces in LAMMPS: formulas that it evaluates at every step.

A grain follows its path by `fix move variable`, a wall is a region that moves, a force is that of
`fix addforce`. LAMMPS evaluates the formulas in double precision at its own times, `step*dt`: they
are right to 1e-16 (1 + omega t) of their amplitude. That is velocity Verlet; with methods of
several drifts the values come from outside, at the times of the method.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

from ...scene.base import Excitation
from ...scene.waveform import Waveform

# Coefficients of the current cubic piece, in powers of the time since its begin.
PIECE = ("begin", "c0", "c1", "c2", "c3")
SINCE = "(v_now-v_begin)"
SINE = "v_amplitude*sin(v_omega*v_now)"
INSIDE = "sin(v_envelope*v_now)^2"
BEFORE = "*(v_now<v_end)"


def placeholders(excitation: Excitation, duration: float) -> dict[str, Any]:
    """Return the values of the templates for an excitation that acts during the run."""
    wave = excitation.waveform
    force = excitation.wall is None and not excitation.driven
    return {
        "wave": wave,
        "wave_unit": "N" if force else "m",
        "frequency": wave.omega / (2 * math.pi) if wave else 0.0,
        "cycles": wave.omega / (2 * wave.envelope) if wave and wave.envelope else 0.0,
        "driven": excitation.driven,
        "pushed": excitation.acts_on if force else 0,
        "value": value(wave) if wave else "",
        "slope": slope(wave) if wave else "",
        "pieces": pieces(excitation, duration),
    }


def value(wave: Waveform) -> str:
    """Return a waveform, upward, in variables of LAMMPS."""
    if wave.spline is not None:
        return f"-(v_c0+{SINCE}*(v_c1+{SINCE}*(v_c2+{SINCE}*v_c3)))"
    return f"-{SINE}" + (f"*{INSIDE}" if wave.envelope else "") + (BEFORE if wave.corners else "")


def slope(wave: Waveform) -> str:
    """Return the time derivative of a waveform, upward, in variables of LAMMPS."""
    if wave.spline is not None:
        return f"-(v_c1+{SINCE}*(2.0*v_c2+3.0*{SINCE}*v_c3))"
    plain = "-v_amplitude*v_omega*cos(v_omega*v_now)"
    if not wave.envelope:
        return plain + (BEFORE if wave.corners else "")
    return f"({plain}*{INSIDE}-{SINE}*v_envelope*sin(2.0*v_envelope*v_now)){BEFORE}"


def pieces(excitation: Excitation, duration: float) -> list[tuple[float, list[str]]]:
    """Return the end of each cubic piece of a spline, s, and the commands that apply it."""
    wave = excitation.waveform
    if wave is None or wave.spline is None:
        return []
    cubics = []
    for k, (begin, end) in enumerate(pairwise(wave.spline.x.tolist())):
        if begin < duration:
            values = (begin, *wave.spline.c[::-1, k].tolist())
            variables = zip(PIECE, values, strict=True)
            cubics.append((end, [f"variable {name} string {value!r}" for name, value in variables]))
    return cubics
