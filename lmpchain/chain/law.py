"""Force laws that users write as formulas: of contacts, and of springs between grains and ground.

========  ==========  ========================================================
symbol    in formula  meaning
========  ==========  ========================================================
o         o           overlap of a contact, m; below 0 a gap or a stretched bond
K         k           constant of a contact, of the chain unless it is given
u         u           displacement of a grain from rest, m, in a ground law
t         t           time, s, in a ground law
========  ==========  ========================================================
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..errors import InputError
from ..util.arrays import Array, read_only
from ..util.caching import cached_property
from ..util.tables import counted
from .contact_law import ContactLaw
from .formula import MAX_NUMBER, ZERO, Formula, build, name, negative, number, parse

VARIABLES = ("o", "u", "t")
# The power of the overlap with which a smooth force is said to set in: no contact opens.
SMOOTH = 1.5
# Derivatives that are compared on both sides of a kink.
COMPARED = 4
# Distance to a kink, over its overlap, at which a fractional power is measured.
NEAR_KINK = 1e-6
NUMPY: dict[str, Any] = {
    **{
        key: getattr(np, key)
        for key in ("maximum", "minimum", "absolute", "sqrt", "exp", "log", "sin", "cos", "tanh")
    },
    "select": np.where,
    "__name__": __name__,
}


class Law(ContactLaw):
    """The force of a contact, or of a spring to the ground, by a formula.

    Two laws are equal if their formulas, as printed, and their parameters are.

    Parameters
    ----------
    force : str
        The force in N. Of a contact: with which two grains push each other apart, as a function of
        the overlap ``o`` in m; ``o < 0`` is a gap, or a stretched bond if the force is not 0 there.
        Of the ground: that pulls a grain back, as a function of its displacement ``u`` from rest in
        m, and of the time ``t`` in s. `lmpchain.chain.formula` lists what a formula may hold.
    **parameters : float or (N-1,) array
        Numbers for the other names, of all contacts or of each (of a ground: of each grain). ``k``
        is the constant of the contacts of the chain unless it is given. A wall has the parameters
        of the contact next to it.

    Raises
    ------
    InputError
        With the key ``force``, or that of a parameter.

    Examples
    --------
    >>> law = Law("k*max(o, 0)**1.5*(1 + c*o)", k=1e9, c=1e4)
    >>> law
    Law('k*max(o, 0)**1.5*(1 + c*o)', k=1000000000, c=10000)
    >>> f"{law.force(1e-6):.4f} N, {law.stiffness(1e-6):.4g} N/m"
    '1.0100 N, 1.525e+06 N/m'
    >>> f"{float(law.overlap(1.01)):.6g} m"
    '1e-06 m'
    """

    formula: Formula
    given: dict[str, float | tuple[float, ...]]

    def __init__(self, force: str, /, **parameters: Any):
        formula = parse(force)
        names = formula.names
        needed = [key for key in names if key not in VARIABLES]
        faults = list(_misfits(names, needed, parameters))
        given = {}
        for key in dict.fromkeys([*(key for key in ("k",) if key in parameters), *needed]):
            if key in parameters:
                try:
                    given[key] = _number(key, parameters[key])
                except InputError as error:
                    faults += list(error.faults)
        if faults:
            raise InputError(faults)
        lengths = {len(value) for value in given.values() if isinstance(value, tuple)}
        if len(lengths) > 1:
            raise InputError.at("force", f"has parameters of lengths {sorted(lengths)}")
        self._set(formula, given)

    def _set(self, formula: Formula, given: dict[str, float | tuple[float, ...]]) -> None:
        object.__setattr__(self, "formula", formula)
        object.__setattr__(self, "given", given)
        arguments = {key: f"p[{n}]" for n, key in enumerate(self.names)}
        force, stiffness, curvature = (
            formula.function("o, k, p", NUMPY, arguments) for formula in self._formulas
        )
        kinks = [place.substitute(self._numbers(0)) for place in formula.kinks("o")]
        values = sorted({k for place in kinks if (k := place.number) is not None})
        super().__init__(
            force,
            stiffness,
            curvature,
            onset=SMOOTH,
            parameters=tuple(_array(given[key]) for key in self.names),
            kinks=tuple(values),
            name=self.text,
        )
        object.__setattr__(self, "onset", self._onset())

    @property
    def names(self) -> list[str]:
        """Names of the parameters but k, in the order of `parameters`."""
        return [key for key in self.given if key != "k"]

    @property
    def text(self) -> str:
        """The formula as it is printed; reading it gives the same law."""
        return self.formula.text

    @property
    def of_ground(self) -> bool:
        """Whether it is the law of a ground, of the displacement and the time."""
        return any(key in self.formula.names for key in ("u", "t"))

    @cached_property
    def _formulas(self) -> tuple[Formula, Formula, Formula]:
        """Force, stiffness and curvature; 0 where there is no contact, whose constant is 0."""
        force = self.formula
        if force.substitute({"k": 0.0}) is not ZERO:
            force = build("select", negative(name("k")), ZERO, force)
        variable = "u" if self.of_ground else "o"
        stiffness = force.derivative(variable)
        return force, stiffness, stiffness.derivative(variable)

    def _numbers(self, contact: int, constant: float = 1.0) -> dict[str, float]:
        """Return the parameters of one contact."""
        values = {"k": constant}
        for key, value in self.given.items():
            values[key] = value[contact] if isinstance(value, tuple) else value
        return values

    def _onset(self) -> float:
        """Return the lowest power of the distance to a kink with which the force bends there."""
        if self.of_ground:
            return SMOOTH
        whole = self.formula.substitute(self._numbers(0))
        return min((_bend_at(whole, kink) for kink in self.kinks), default=SMOOTH)

    def with_parameters(self, parameters: Iterable[Any]) -> Law:
        """Return the law with other parameters, which may be of higher precision."""
        law = object.__new__(Law)
        law.__dict__.update(self.__dict__)
        object.__setattr__(law, "parameters", tuple(parameters))
        return law

    def constant(self, modulus: Any, radius: Any, length: Any) -> Any:
        """Return the constant K of contacts of spheres, unless the law has its own."""
        k = self.given.get("k")
        return super().constant(modulus, radius, length) if k is None else np.asarray(k)

    def _constant(self, constant: Any) -> Any:
        if constant is not None:
            return constant
        if "k" in self.given:
            return np.asarray(self.given["k"])
        if "k" in self.formula.names:
            raise InputError.at("k", "is not given: name it, as a chain does")
        return 1.0

    def force(self, overlap: Any, constant: Any = None) -> Any:
        """Return the force at an overlap, N."""
        with np.errstate(all="ignore"):
            return super().force(np.asarray(overlap)[()], self._constant(constant))

    def stiffness(self, overlap: Any, constant: Any = None) -> Any:
        """Return the derivative of the force by the overlap, N/m."""
        with np.errstate(all="ignore"):
            return super().stiffness(np.asarray(overlap)[()], self._constant(constant))

    def curvature(self, overlap: Any, constant: Any = None) -> Any:
        """Return the derivative of the stiffness by the overlap, N/m2."""
        with np.errstate(all="ignore"):
            return super().curvature(np.asarray(overlap)[()], self._constant(constant))

    def overlap(self, force: Any, constant: Any = None) -> Any:
        """Return the overlap at which a contact has this force, m."""
        return super().overlap(force, self._constant(constant))

    def energy(self, overlap: Any, constant: Any = None) -> Any:
        """Return the integral of the force over the overlap from 0, J."""
        overlap = np.asarray(overlap, dtype=float)
        constant = self._constant(constant)
        shape = np.broadcast_shapes(overlap.shape, np.shape(constant), *map(np.shape, self.values))
        overlap, constant = (np.broadcast_to(x, shape) for x in (overlap, constant))
        total = np.zeros(shape)
        for place, weight in self._nodes(np.zeros(shape), overlap):
            total += weight * self.force(place, constant)
        return (np.sign(overlap) * total)[()]

    @property
    def values(self) -> list[Any]:
        """The parameters but k, numbers or arrays."""
        return list(self.parameters)

    def lepton(
        self,
        what: str = "energy",
        overlap: str = "-r",
        constant: float | None = None,
        contact: int = 0,
    ) -> str:
        """Return force or energy of one contact in the language of LEPTON, with all numbers in.

        Parameters
        ----------
        what : "energy" or "force"
        overlap : str
            What stands for the overlap o, itself a formula: of the distance ``r`` for instance. Of
            a ground law: what stands for the displacement u.
        constant : float, optional
            K; that of the law by default.
        contact : int
            Index of the contact of which parameters are taken, from 0.

        Raises
        ------
        InputError
            If the energy has no closed form.

        Examples
        --------
        >>> Law("k*max(o, 0)**1.5", k=2.0).lepton(overlap="0.001 - r")
        '(2.0*((max((0.001-r),0.0)^2.5)/2.5))'
        """
        values = self._numbers(contact, float(np.asarray(self._constant(constant)).flat[0]))
        if constant is not None:
            values["k"] = constant
        formula = self.formula.substitute(values)
        variable = "u" if self.of_ground else "o"
        if what == "energy":
            energy = formula.integral(variable)
            if energy is None:
                fault = f"has no energy in closed form: {self.text}"
                raise InputError.at("force", f"{fault}; LAMMPS needs one, the native engine not")
            formula = energy
        return formula.substitute({variable: parse(overlap)}).lepton

    def table(self) -> dict[str, Any]:
        """Return formula and parameters as a scene file has them."""
        return {"force": self.text} | {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in self.given.items()
        }

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Law:
        """Return the law of a table of a scene file, see `table`."""
        rest = dict(table)
        force = rest.pop("force", None)
        if force is None:
            raise InputError.at("force", "is missing: a formula such as 'k*max(o, 0)**1.5'")
        return cls(force, **rest)

    def replace(self, **parameters: Any) -> Law:
        """Return the law with other values of some parameters, or another `force`."""
        return Law.from_table(self.table() | parameters)

    def _key(self) -> tuple[Any, ...]:
        return self.text, tuple(sorted(self.given.items()))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Law) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def __reduce__(self) -> Any:
        return Law.from_table, (self.table(),)

    def __repr__(self) -> str:
        values = "".join(f", {key}={_shown(value)}" for key, value in self.given.items())
        return f"Law({self.text!r}{values})"


def _misfits(
    names: list[str], needed: list[str], parameters: Mapping[str, Any]
) -> Iterable[tuple[str, str]]:
    """Yield what does not fit between a formula and its parameters."""
    if "o" in names and ("u" in names or "t" in names):
        yield "force", "has o, of a contact, beside u or t, of the ground: use one kind"
    if "o" not in names and "u" not in names:
        yield "force", "depends on no overlap o and no displacement u"
    if "force" in needed:
        yield "force", "has a parameter named force: give it another name"
    for key in needed:
        if key not in parameters and (key != "k" or "o" not in names):
            yield key, f"is not given: the formula needs a number, {key} = ..."
    for key in parameters:
        if key in VARIABLES:
            yield key, "is a variable of formulas: give the parameter another name"
        elif key not in needed:
            known = ", ".join(needed) or "none"
            yield key, f"is not in the formula, whose parameters are: {known}"


def _number(key: str, value: Any) -> float | tuple[float, ...]:
    """Return one number, or a tuple of them."""
    try:
        array = np.asarray(value)
        sound = array.dtype.kind in "iuf" and array.ndim <= 1 and array.size > 0
        array = array.astype(float) if sound else array
    except (ValueError, TypeError):
        sound = False
    if not sound:
        raise InputError.at(key, "must be a number, or a list of one for each contact")
    if not (np.abs(array) <= MAX_NUMBER).all():
        raise InputError.at(key, f"must be finite, and no more than {MAX_NUMBER:g}")
    if array.ndim == 0:
        return float(array)
    return tuple(array.tolist())


def _array(value: float | tuple[float, ...]) -> float | Array:
    return read_only(np.array(value)) if isinstance(value, tuple) else value


def _shown(value: float | tuple[float, ...]) -> str:
    if isinstance(value, tuple):
        return counted(len(value), "number")
    return number(value).text


def _bend_at(formula: Formula, kink: float) -> float:
    """Return the lowest power of the distance to a kink that differs on its two sides.

    0 is a jump of the force, 1 one of the stiffness.
    """
    distance = NEAR_KINK * abs(kink) or 1e-40
    below, above = (formula.between_kinks("o", kink + side) for side in (-distance, distance))
    for order in range(COMPARED):
        difference = above.value_at("o", kink) - below.value_at("o", kink)
        if not math.isfinite(difference):
            near, far = (
                above.value_at("o", kink + d) - below.value_at("o", kink + d)
                for d in (distance, 16 * distance)
            )
            grows = math.log(abs(far / near), 16) if near and far else 0.0
            return round(order + max(grows, -1.0), 6)
        scale = abs(above.value_at("o", kink)) + abs(below.value_at("o", kink))
        if abs(difference) > 1e-9 * scale:
            return float(order)
        below, above = below.derivative("o"), above.derivative("o")
    return float(COMPARED)
