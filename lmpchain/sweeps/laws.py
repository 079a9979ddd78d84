"""Laws by which the values of a sweep are drawn: one number a scene, or one for every grain of it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError
from ..util.arrays import Array
from ..util.validation import Checked, Positive, Real

MARKS = {"low", "high", "mean", "deviation"}  # of a table that is a law
# keys of the scene file that hold a number a grain, and how many fewer than grains; constants are a
# number a contact
ARRAYS = {
    "chain.masses": 0,
    "chain.diameter": 0,
    "chain.contact_constants": 1,
    "chain.material.density": 0,
    "chain.material.youngs_modulus": 0,
    "chain.material.poissons_ratio": 0,
}
# of these, those that are never one number for all
ALWAYS = ("chain.masses", "chain.contact_constants")


class Uniform(Checked):
    """Between what numbers a key is drawn: evenly, or with its logarithm even."""

    low: Real
    high: Real
    log: bool = False
    per_grain: bool = False

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.low >= self.high:
            yield "high", f"must be above low, {self.low:g} (got {self.high:g})"
        if self.log and self.low <= 0:
            yield "low", f"must be above 0 where log is true (got {self.low:g})"

    def at(self, part: Array) -> Array:
        """Return the numbers below which these parts of all draws lie."""
        if self.log:
            return np.exp(math.log(self.low) + part * math.log(self.high / self.low))
        return self.low + part * (self.high - self.low)


class Normal(Checked):
    """Mean and standard deviation of what is drawn: it, or its logarithm, is normally distributed."""

    mean: Real
    deviation: Positive
    log: bool = False
    per_grain: bool = False

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.log and self.mean <= 0:
            yield "mean", f"must be above 0 where log is true (got {self.mean:g})"

    def at(self, part: Array) -> Array:
        """Return the numbers below which these parts of all draws lie."""
        from scipy.special import ndtri

        if self.log:
            square = math.log1p((self.deviation / self.mean) ** 2)
            return self.mean * np.exp(math.sqrt(square) * ndtri(part) - square / 2)
        return self.mean + self.deviation * ndtri(part)


def law(table: Any) -> Uniform | Normal:
    """Return the law that a table stands for; raises `InputError`."""
    if not isinstance(table, Mapping):
        cure = "such as {low = 1.0, high = 10.0} or {mean = 5.0, deviation = 1.0}"
        raise InputError.at("", f"must be a range or a distribution, {cure}")
    return Normal(**table) if table.keys() & {"mean", "deviation"} else Uniform(**table)


@dataclass(frozen=True)
class Drawn:
    """A key of which every grain gets a number of its own, drawn anew for every scene.

    Scene number i takes its numbers from `numpy.random.default_rng(SeedSequence(seed, spawn_key=(i,
    k)))`, k being the first four bytes of the SHA-256 of the key, so that they depend on nothing
    else that is drawn.
    """

    key: str
    law: Uniform | Normal
    seed: int

    def values(self, index: int, grains: int) -> Array:
        """Return the numbers of a scene, one a grain or contact."""
        mark = int.from_bytes(hashlib.sha256(self.key.encode()).digest()[:4], "big")
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(index, mark)))
        return self.law.at(rng.random(grains - ARRAYS[self.key]))


def drawn(laws: Mapping[str, Uniform | Normal], seed: int) -> tuple[Drawn, ...]:
    """Return what is drawn for every grain; raises `InputError` for keys that hold no number a grain."""
    if wrong := [key for key in laws if key not in ARRAYS]:
        raise InputError(
            [
                (key, f"has no value a grain; those that have are {', '.join(ARRAYS)}")
                for key in wrong
            ]
        )
    return tuple(Drawn(key, each, seed) for key, each in laws.items())
