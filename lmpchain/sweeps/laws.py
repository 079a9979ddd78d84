"""Random laws of a sweep: one number for each scene, or one for each of its grains."""

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

MARKS = {"low", "high", "mean", "deviation"}  # Keys that mark a table as a law.
CONTACT_CONSTANTS = "chain.contact_constants"
VISCOSITY = "chain.damping.viscoelastic"
BETWEEN_GRAINS = (CONTACT_CONSTANTS, VISCOSITY)
DAMPING = (VISCOSITY, "chain.damping.drag")
# Keys of a scene file with a number for each grain, or for each contact (`BETWEEN_GRAINS`).
GRAIN_KEYS = (
    "chain.masses",
    "chain.diameter",
    CONTACT_CONSTANTS,
    "chain.material.density",
    "chain.material.youngs_modulus",
    "chain.material.poissons_ratio",
    *DAMPING,
)
ALWAYS = ("chain.masses", CONTACT_CONSTANTS)  # Keys that never have one number for all grains.


class Uniform(Checked):
    """Uniform distribution between two numbers, of a value or of its logarithm."""

    low: Real
    high: Real
    log: bool = False
    per_grain: bool = False

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.low >= self.high:
            yield "high", f"must be above low, {self.low:g} (got {self.high:g})"
        if self.log and self.low <= 0:
            yield "low", f"must be above 0 where log is true (got {self.low:g})"

    def at(self, share: Array) -> Array:
        """Return the quantiles of the distribution at these probabilities."""
        if self.log:
            return np.exp(math.log(self.low) + share * math.log(self.high / self.low))
        return self.low + share * (self.high - self.low)


class Normal(Checked):
    """Normal distribution of a value or its logarithm; mean and deviation of the value."""

    mean: Real
    deviation: Positive
    log: bool = False
    per_grain: bool = False

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.log and self.mean <= 0:
            yield "mean", f"must be above 0 where log is true (got {self.mean:g})"

    def at(self, share: Array) -> Array:
        """Return the quantiles of the distribution at these probabilities."""
        from scipy.special import ndtri

        if self.log:
            # These are the parameters of the normal distribution of the logarithm.
            variance = math.log1p((self.deviation / self.mean) ** 2)
            return self.mean * np.exp(math.sqrt(variance) * ndtri(share) - variance / 2)
        return self.mean + self.deviation * ndtri(share)


def make_law(table: Any) -> Uniform | Normal:
    """Return the law that a table describes; raise `InputError` if the table is invalid."""
    if not isinstance(table, Mapping):
        cure = "such as {low = 1.0, high = 10.0} or {mean = 5.0, deviation = 1.0}"
        raise InputError.at("", f"must be a range or a distribution, {cure}")
    return Normal(**table) if table.keys() & {"mean", "deviation"} else Uniform(**table)


@dataclass(frozen=True)
class GrainLaw:
    """A key with a random number for each grain, drawn anew for every scene.

    The numbers of scene i are drawn by `numpy.random.default_rng(SeedSequence(seed, spawn_key=(i,
    k)))`, where k is the first four bytes of the SHA-256 of the key. They therefore do not depend
    on any other random number.
    """

    key: str
    law: Uniform | Normal
    seed: int

    @property
    def of_contacts(self) -> bool:
        """Whether each contact has a number; there is one contact fewer than grains."""
        return self.key in BETWEEN_GRAINS

    def values(self, index: int, grains: int) -> Array:
        """Return the random numbers of a scene, one for each grain or contact."""
        # Numbers of one key depend on no other key, nor on the order of the axes.
        mark = int.from_bytes(hashlib.sha256(self.key.encode()).digest()[:4], "big")
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(index, mark)))
        return self.law.at(rng.random(grains - self.of_contacts))


def bind_laws(laws: Mapping[str, Uniform | Normal], seed: int) -> tuple[GrainLaw, ...]:
    """Return the laws of numbers for each grain; raise `InputError` for other keys."""
    cure = f"use one of {', '.join(GRAIN_KEYS)}"
    fault = f"has no separate value for each grain: {cure}"
    if faults := [(key, fault) for key in laws if key not in GRAIN_KEYS]:
        raise InputError(faults)
    return tuple(GrainLaw(key, law, seed) for key, law in laws.items())
