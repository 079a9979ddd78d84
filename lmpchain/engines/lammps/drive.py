"""A driven grain in LAMMPS: `fix move variable` with formulas evaluated at every step."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from ...scene.base import Excitation
from ...scene.excitation import Drive

# of the cubic piece that holds now, in powers of the time since it began
PIECE = ("begin", "c0", "c1", "c2", "c3")


def placeholders(excitation: Excitation, duration: float) -> dict[str, Any]:
    """Return what the templates say of an excitation that acts during the run."""
    drive = excitation if isinstance(excitation, Drive) else None
    return {
        "drive": drive,
        "formulas": formulas(drive) if drive else (),
        "pieces": pieces(excitation, duration),
    }


def formulas(drive: Drive) -> tuple[str, str]:
    """Return height and upward velocity of the driven grain, relative to rest, in LAMMPS variables."""
    if drive.times is None:
        return "-v_amplitude*sin(v_omega*v_now)", "-v_amplitude*v_omega*cos(v_omega*v_now)"
    since = "(v_now-v_begin)"
    path = f"-(v_c0+{since}*(v_c1+{since}*(v_c2+{since}*v_c3)))"
    return path, f"-(v_c1+{since}*(2.0*v_c2+3.0*{since}*v_c3))"


def pieces(excitation: Excitation, duration: float) -> list[tuple[float, list[str]]]:
    """Return when each cubic piece of a sampled motion ends, s, and the commands that put it in force."""
    if not isinstance(excitation, Drive) or excitation.times is None:
        return []
    spline = excitation.waveform.spline
    assert spline is not None
    cubics = []
    for k, (begin, end) in enumerate(pairwise(spline.x.tolist())):
        if begin < duration:
            values = (begin, *spline.c[::-1, k].tolist())
            cubics.append(
                (end, [f"variable {name} string {value!r}" for name, value in zip(PIECE, values, strict=True)])
            )
    return cubics
