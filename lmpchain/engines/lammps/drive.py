"""What acts on a column in LAMMPS during a run: formulas that it evaluates at every step.

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

# of the cubic piece that holds now, in powers of the time since it began
PIECE = ("begin", "c0", "c1", "c2", "c3")
SINCE = "(v_now-v_begin)"
SINE = "v_amplitude*sin(v_omega*v_now)"
INSIDE = "sin(v_envelope*v_now)^2"
BEFORE = "*(v_now<v_end)"


def placeholders(excitation: Excitation, duration: float) -> dict[str, Any]:
    """Return what the templates say of an excitation that acts during the run."""
    wave = excitation.waveform
    what = "force" if excitation.wall is None and not excitation.driven else "displacement"
    return {
        "wave": wave,
        "wave_unit": "N" if what == "force" else "m",
        "frequency": wave.omega / (2 * math.pi) if wave else 0.0,
        "cycles": wave.omega / (2 * wave.envelope) if wave and wave.envelope else 0.0,
        "driven": excitation.driven,
        "pushed": getattr(excitation, "grain", 0) if wave and what == "force" else 0,
        "value": value(wave) if wave else "",
        "slope": slope(wave) if wave else "",
        "pieces": pieces(excitation, duration),
    }


def value(wave: Waveform) -> str:
    """Return what goes over time, upward, in LAMMPS variables."""
    if wave.spline is not None:
        return f"-(v_c0+{SINCE}*(v_c1+{SINCE}*(v_c2+{SINCE}*v_c3)))"
    return f"-{SINE}" + (f"*{INSIDE}" if wave.envelope else "") + (BEFORE if wave.corners else "")


def slope(wave: Waveform) -> str:
    """Return its rate, upward, in LAMMPS variables."""
    if wave.spline is not None:
        return f"-(v_c1+{SINCE}*(2.0*v_c2+3.0*{SINCE}*v_c3))"
    plain = "-v_amplitude*v_omega*cos(v_omega*v_now)"
    if not wave.envelope:
        return plain + (BEFORE if wave.corners else "")
    return f"({plain}*{INSIDE}-{SINE}*v_envelope*sin(2.0*v_envelope*v_now)){BEFORE}"


def pieces(excitation: Excitation, duration: float) -> list[tuple[float, list[str]]]:
    """Return when each cubic piece of a spline ends, s, and the commands that put it in force."""
    wave = excitation.waveform
    if wave is None or wave.spline is None:
        return []
    cubics = []
    for k, (begin, end) in enumerate(pairwise(wave.spline.x.tolist())):
        if begin < duration:
            values = (begin, *wave.spline.c[::-1, k].tolist())
            cubics.append(
                (
                    end,
                    [
                        f"variable {name} string {value!r}"
                        for name, value in zip(PIECE, values, strict=True)
                    ],
                )
            )
    return cubics
