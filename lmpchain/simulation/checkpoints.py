"""Checkpoints of a run: the two newest, each with its hash, so that damage is noticed."""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .. import engines
from ..engines.base import Proposal
from ..integrators.steps import Steps
from ..util.arrays import Array
from ..util.files import replacing, unpack

NAMES = ("checkpoint", "checkpoint-before")
STATE = "state."  # before the names of the arrays of a state, so that they never meet another
HASH = hashlib.sha256
LENGTH = HASH().digest_size
# A proposal in the notes of older versions, in this order where it is a list.
OLD_PROPOSAL = ("step", "active_grains", "model_error", "solver_error", "cost_s", "tolerance",
                "steps_per_landing", "stride", "fixed", "adaptive", "coarse_openings", "integrator",
                "choices")  # fmt: skip


class Checkpoint(NamedTuple):
    """Notes, and the state of a run, which is empty before its first sample."""

    notes: dict[str, Any]
    state: dict[str, Array]


def save(folder: Path, notes: Mapping[str, Any], state: Mapping[str, Array]) -> None:
    """Write a checkpoint; at every moment a complete one is on the disk."""
    # packed in memory first, so that the hash is of what is written
    packed = io.BytesIO()
    arrays = {STATE + name: values for name, values in state.items()}
    np.savez(packed, notes=np.array(json.dumps(notes)), **arrays)  # type: ignore[arg-type]
    content = packed.getbuffer()
    newest, before = (folder / name for name in NAMES)
    with replacing(newest) as aside:
        with open(aside, "wb") as opened:
            opened.write(HASH(content).digest())
            opened.write(content)
        # renamed before the new one is moved into place: a kill leaves one of them whole
        if newest.exists():
            os.replace(newest, before)


def load(folder: Path) -> Iterator[Checkpoint | None]:
    """Yield the checkpoints, the newest first; None for a damaged one, which is removed."""
    for path in (folder / name for name in NAMES):
        if path.exists():
            checkpoint = None
            if is_intact(path):
                checkpoint = _unpack(memoryview(path.read_bytes())[LENGTH:])
            if checkpoint is None:
                path.unlink()
            yield checkpoint


def is_intact(path: Path) -> bool:
    """Return whether a checkpoint is as it was written."""
    content = memoryview(path.read_bytes())
    return HASH(content[LENGTH:]).digest() == content[:LENGTH]


def _unpack(content: memoryview) -> Checkpoint | None:
    try:
        arrays = unpack(content)
        notes = json.loads(str(arrays["notes"]))
        state = {
            name.removeprefix(STATE): values
            for name, values in arrays.items()
            if name.startswith(STATE)
        }
        return Checkpoint(dict(notes), state)
    except Exception:
        # whatever it is, it is no checkpoint, though it bears its hash
        return None


def renew(attempt: Mapping[str, Any]) -> dict[str, Any]:
    """Return the notes of an attempt as this version writes them, from those of any version."""
    renewed = dict(attempt)
    if "candidate" in renewed:
        engine = renewed.pop("engine")
        renewed["proposal"] = _renew_proposal(engine, renewed.pop("candidate"))
        if renewed["best"]:
            error, best = renewed["best"]
            old = dict(zip(OLD_PROPOSAL, best, strict=True))
            renewed["best"] = error, _renew_proposal(engine, old)
    return renewed


def _renew_proposal(engine: str, old: Mapping[str, Any]) -> dict[str, Any]:
    """Return the notes of a proposal from those of older versions, which had no record of steps."""
    new = {key: old[key] for key in OLD_PROPOSAL}
    steps = Steps(
        per_landing=new.pop("steps_per_landing"),
        stride=new.pop("stride"),
        step=new.pop("step"),
        adaptive=new.pop("adaptive"),
        coarse_openings=new.pop("coarse_openings"),
        dense=int(old["stride"] > 1),
    )
    # Diameters were written as text.
    choices = {
        key: float(text) if key.endswith("_m") else text for key, text in old["choices"].items()
    }
    equation = engines.get(engine).equation
    fields = {"engine": engine, "equation": equation, "steps": steps._asdict(), "choices": choices}
    return Proposal(**new | fields)._asdict()
