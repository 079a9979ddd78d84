"""Contact laws by formula."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, InstanceOf

from ..errors import InputError
from ..util.arrays import Array, numbers, read_only
from .contact_law import ContactLaw, Formula, RestingContacts
from .formula import canonical, compiled, derivative, kinks_of, names_in, parse

FORCE = "force"  # key of the formula in the table [chain.law]
CONSTANT = "k"  # the contact constant, which the chain gives unless the law does
# Overlaps at which the equilibrium is bracketed, over that at rest without load, m.
SCAN = np.concatenate(([0.0], np.geomspace(1e-18, 1.0, 181)))
FARTHEST = 1.0  # m; an overlap beyond counts as infinite
NEAR = 1e-25  # m, from a kink at 0 at which its power is read off
RELATIVE = 1e-7  # the same over the overlap of another kink
# Power of a law without kinks: no method of the package has this order.
SMOOTH = 20.0


class Functions(NamedTuple):
    """The compiled functions of a formula, of (o, K, p) each.

    Attributes
    ----------
    names : tuple of str
        Parameters without the variable and `CONSTANT`, in the order of p.
    force, stiffness, curvature : functions
    kinks : tuple of (function, function, function)
        For each kink an expression that is 0 there, the difference of the force with either
        branch, and the derivative of that difference.
    uses_constant : bool
        Whether the formula contains `CONSTANT`.
    """

    names: tuple[str, ...]
    force: Formula
    stiffness: Formula
    curvature: Formula
    kinks: tuple[tuple[Formula, Formula, Formula], ...]
    uses_constant: bool


@cache
def functions_of(formula: str) -> Functions:
    """Return the functions of a formula of the overlap o; raise `InputError` if it is none."""
    try:
        return _derive(parse(formula, FORCE))
    except RecursionError:
        raise InputError.at(FORCE, "is nested too deeply: write a simpler formula") from None


def _derive(tree: ast.expr) -> Functions:
    """Return the functions of a checked formula."""
    names = tuple(name for name in names_in(tree) if name not in ("o", CONSTANT))
    meanings: dict[str, ast.expr] = {
        name: ast.parse(f"p[{n}]", mode="eval").body for n, name in enumerate(names)
    }
    meanings |= {"o": ast.Name("o", ast.Load()), CONSTANT: ast.Name("K", ast.Load())}

    def function(expression: ast.expr) -> Formula:
        return compiled(expression, ("o", "K", "p"), meanings, FORCE)  # type: ignore[no-any-return]

    slope = derivative(tree, "o")
    kinks = []
    for place, jump in kinks_of(tree):
        kinks.append((function(place), function(jump), function(derivative(jump, "o"))))
    return Functions(
        names,
        function(tree),
        function(slope),
        function(derivative(slope, "o")),
        tuple(kinks),
        CONSTANT in names_in(tree),
    )


class Law(ContactLaw):
    """A contact law given by one formula of the overlap.

    The formula gives the force in N with which two grains push each other apart, as a function of
    the overlap o in m. Below o = 0 there is a gap, or a bond is stretched: write ``max(o, 0)`` if
    an open contact has no force.

    Parameters
    ----------
    formula : str
        Numbers, o, parameters, ``+ - * / **`` and the functions min, max, abs, sqrt, exp, log, sin,
        cos, tanh and step (1 from 0 on, else 0).
    **parameters : float or (N-1,) array
        One number, or one for each contact between grains; a wall takes the value of the contact
        next to it. k is the contact constant of the chain unless it is given.

    Raises
    ------
    InputError
        If the text is not such a formula, a parameter is missing or unknown, the force jumps, or
        is not a number for o < 0.

    Examples
    --------
    >>> law = Law("k*max(o, 0)**1.5*(1 + c*o)", k=1e9, c=1e4)
    >>> f"{law.force(1e-6):.3f} N, {law.stiffness(1e-6):.0f} N/m"
    '1.010 N, 1525000 N/m'
    >>> law
    Law('k * max(o, 0.0) ** 1.5 * (1.0 + c * o)', c=10000.0, k=1000000000.0)
    """

    formula: str
    values: tuple[tuple[str, Any], ...]

    def __init__(self, formula: str, **parameters: Any):
        if not isinstance(formula, str):
            raise InputError.at(FORCE, f"must be a formula in quotes (got {formula!r})")
        functions = functions_of(formula)
        known = {*functions.names, *([CONSTANT] if functions.uses_constant else [])}
        faults = [
            (name, "does not occur in the formula: take it out")
            for name in parameters
            if name not in known
        ]
        faults += [
            (name, f"has no value: give {name} a number")
            for name in functions.names
            if name not in parameters
        ]
        if faults:
            raise InputError(faults)
        values = {name: _value(name, parameters[name]) for name in sorted(parameters)}
        self._set(canonical(parse(formula, FORCE)), functions, values)

    def _set(self, formula: str, functions: Functions, values: Mapping[str, Any]) -> None:
        """Set all fields of this frozen value."""
        given = tuple(values[name] for name in functions.names)
        constant = values.get(CONSTANT, 1.0)
        fields = {
            "formula": formula,
            "values": tuple(values.items()),
            "force_formula": functions.force,
            "stiffness_formula": functions.stiffness,
            "curvature_formula": functions.curvature,
            "parameters": given,
            "name": f"the law {formula}",
        }
        for name, value in fields.items():
            object.__setattr__(self, name, value)
        kinks = list(_kinks(functions, constant, given))
        places = {np.asarray(place).tobytes(): place for place, _ in kinks}
        object.__setattr__(self, "kinks", tuple(places.values()))
        object.__setattr__(self, "onset", min([power for _, power in kinks], default=SMOOTH))
        with np.errstate(all="ignore"):
            if not np.isfinite(functions.force(np.float64(0.0), constant, given)).all():
                raise InputError.at(FORCE, "is not a number at o = 0")
            if not np.isfinite(functions.force(np.float64(-1e-12), constant, given)).all():
                raise InputError.at(
                    FORCE, "is not a number for o < 0: write max(o, 0) in place of o"
                )

    @property
    def given_constant(self) -> Any:
        """The contact constant that the law gives, one or (N-1,); None if the chain gives it."""
        return dict(self.values).get(CONSTANT)

    @property
    def adheres(self) -> bool:
        """Whether contacts are compressed at rest without any load, by a pull at o = 0."""
        return bool((self.force(0.0, 1.0) < 0).any())

    @property
    def table(self) -> dict[str, Any]:
        """The table ``[chain.law]`` of a scene file."""
        return {"force": self.formula} | dict(self.values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Law) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[Any, ...]:
        values = ((name, np.asarray(value).tobytes()) for name, value in self.values)
        return self.formula, *values

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (self.formula, dict(self.values))

    def __repr__(self) -> str:
        values = "".join(f", {name}={value!r}" for name, value in self.values)
        return f"Law({self.formula!r}{values})"

    def with_parameters(self, parameters: Iterable[Any]) -> Law:
        """Return the law with other parameters, which may be arrays or of higher precision."""
        functions = functions_of(self.formula)
        law = object.__new__(Law)
        law._set(
            self.formula,
            functions,
            dict(self.values) | dict(zip(functions.names, parameters, strict=True)),
        )
        return law

    def misfits(self, grains: int) -> Iterator[tuple[str, str]]:
        """Yield parameters that do not fit a chain of this length, and kinks away from o = 0."""
        for name, value in self.values:
            if np.ndim(value) and len(value) != grains - 1:
                count = f"{grains - 1} entries for {grains} grains"
                yield f"law.{name}", f"must be one number, or have {count}, not {len(value)}"
        if elsewhere := [kink for kink in self.kinks if np.any(kink)]:
            place = f"{np.ravel(elsewhere[0])[0]:.3g} m"
            fault = "no method keeps its order there: put the kink at o = 0"
            yield "law.force", f"has a kink at o = {place}; {fault}"

    def spread(self, grains: int) -> Law:
        """Return the law with each array of parameters for all contacts, walls included, (N+1,)."""
        if not any(np.ndim(value) for value in self.parameters):
            return self
        return self.with_parameters(
            np.concatenate((value[:1], value, value[-1:])) if np.ndim(value) else value
            for value in self.parameters
        )

    def part(self, contacts: slice) -> Law:
        """Return the law of some of the N-1 contacts between grains."""
        values = {n: v[contacts] if np.ndim(v) else v for n, v in self.values}
        return Law(self.formula, **values)

    def of(self, numbers: Any) -> Law:
        """Return the law of some of all N+1 contacts, of a law that was `spread`."""
        if not any(np.ndim(value) for value in self.parameters):
            return self
        return self.with_parameters(
            value[numbers] if np.ndim(value) else value for value in self.parameters
        )

    def constant(self, modulus: Any, radius: Any, length: Any) -> Any:
        """Return the contact constant that the law gives, else Hertz's, N/m^1.5."""
        if self.given_constant is None:
            return super().constant(modulus, radius, length)
        return np.asarray(self.given_constant)

    def _constant(self, constant: Any) -> Any:
        """Return the contact constant of a call from outside."""
        if constant is None:
            constant = self.given_constant
        if constant is None and functions_of(self.formula).uses_constant:
            raise InputError.at(CONSTANT, "has no value outside a chain: give k a number")
        return 1.0 if constant is None else constant

    def force(self, overlap: Any, constant: Any = None) -> Any:
        """Return the force at an overlap, N; arrays broadcast."""
        return self._at(self.force_formula, overlap, constant)

    def stiffness(self, overlap: Any, constant: Any = None) -> Any:
        """Return the derivative of the force, N/m; arrays broadcast."""
        return self._at(self.stiffness_formula, overlap, constant)

    def curvature(self, overlap: Any, constant: Any = None) -> Any:
        """Return the second derivative of the force, N/m2; arrays broadcast."""
        return self._at(self.curvature_formula, overlap, constant)

    def energy(self, overlap: Any, constant: Any = None) -> Any:
        """Return the work that takes the contact from o = 0 to an overlap, J; arrays broadcast."""
        constant = self._constant(constant)
        overlap = np.asarray(overlap, dtype=float)
        zero = np.zeros_like(overlap)
        with np.errstate(all="ignore"):
            return self.force(zero, constant) * overlap + self._energy(zero, overlap, constant)

    def _at(self, formula: Formula, overlap: Any, constant: Any) -> Any:
        constant = self._constant(constant)
        # Branches that are not taken may divide by 0.
        with np.errstate(all="ignore"):
            value = formula(np.asarray(overlap), constant, self.parameters)
        # Where there is no contact, terms without k would still give a force.
        return np.where(np.asarray(constant) > 0, value, 0.0)[()]

    def largest_stiffness(self, overlap: Any, constant: Any) -> Any:
        """Return the largest stiffness at overlaps up to this size on either side of 0, N/m."""
        closer = super().largest_stiffness(overlap, constant)
        return np.maximum(closer, super().largest_stiffness(-overlap, constant))

    def overlap(self, force: Any, constant: Any = None) -> Any:
        """Return the overlap at which a contact is in equilibrium under a force, m.

        The load grows from 0 at the overlap next to 0 without force, and the stiffness must stay
        positive on the way.

        Raises
        ------
        InputError
            If there is no such overlap.
        """
        force, constant = np.broadcast_arrays(
            np.asarray(force, dtype=float), self._constant(constant)
        )
        with np.errstate(all="ignore"):
            rest = self._unloaded(constant)
            rows = [rest + step for step in SCAN]
            forces = np.array([self.force(row, constant) for row in rows])
        reached = forces >= force
        first = reached.argmax(axis=0)
        before = np.maximum(first - 1, 0)

        def pick(index: NDArray[np.intp]) -> Array:
            return np.take_along_axis(np.array(rows), index[np.newaxis], axis=0)[0]

        rises = np.diff(forces, axis=0, prepend=forces[:1]) >= 0
        # Every step up to the first overlap that carries the load must raise the force.
        steps = np.arange(len(SCAN)).reshape(-1, *[1] * force.ndim)
        sound = (rises | (steps > first)).all(axis=0) & reached.any(axis=0)
        loaded = force > 0
        if (loaded & ~sound).any():
            worst = float(force[loaded & ~sound].max())
            raise InputError.at(
                "law", f"has no stable equilibrium under {worst:.3g} N: load the chain less"
            )
        low, high = pick(before), pick(first)
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            above = self.force(middle, constant) >= force
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        return np.where(loaded, high, rest)

    def _unloaded(self, constant: Array) -> Array:
        """Return the stable overlap without force that is next to 0, m."""
        at_zero = self.force(np.zeros_like(constant, dtype=float), constant)
        if not (at_zero != 0).any():
            return np.zeros(constant.shape)
        # A pull at o = 0, as of adhesion, is balanced at an overlap above 0, a push below 0.
        steps = np.sign(-at_zero) * SCAN.reshape(-1, *[1] * constant.ndim)
        forces = self.force(steps, constant)
        crossed = (forces * np.sign(at_zero) <= 0) | (at_zero == 0)
        if not crossed.any(axis=0).all():
            raise InputError.at(
                "law", "has no equilibrium without load: the force must be 0 at some overlap"
            )
        first = crossed.argmax(axis=0)[np.newaxis]
        low = np.take_along_axis(steps, np.maximum(first - 1, 0), axis=0)[0]
        high = np.take_along_axis(steps, first, axis=0)[0]
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            beyond = self.force(middle, constant) * np.sign(at_zero) <= 0
            low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
        return np.where(at_zero == 0, 0.0, high)

    def _approach(self, energy: Array, constant: Array, rest: Array) -> Array:
        """Return how far a contact moves if it holds this energy above rest, m.

        Bodies that nothing holds together may move apart without end, where no force acts.
        """
        closer, apart = (self._reach(energy, constant, rest, sign) for sign in (1.0, -1.0))
        return np.where(np.isfinite(apart), np.fmax(closer, apart), closer)

    def _reach(self, energy: Array, constant: Array, rest: Array, sign: float) -> Array:
        """Return how far a contact moves on one side, m; infinite if nothing stops it."""
        rows = SCAN[::4]
        low = np.zeros(energy.shape, dtype=int)
        high = np.full(energy.shape, len(rows))
        # The energy grows with the distance: bisect the rows.
        with np.errstate(all="ignore"):
            while (high - low > 1).any():
                middle = (low + high) // 2
                held = self._energy(rest, sign * rows[middle], constant)
                low, high = (
                    np.where(held < energy, middle, low),
                    np.where(held < energy, high, middle),
                )
        return np.where(energy > 0, np.append(rows, np.inf)[high], 0.0)

    def squeezed_by(self, contacts: RestingContacts, force: Any) -> Any:
        """Return by how much more contacts overlap under this additional force, m."""
        return self.overlap(contacts.force + force, contacts.constant) - contacts.overlap


BISECTIONS = 200


def _rebuild(formula: str, values: dict[str, Any]) -> Law:
    return Law(formula, **values)


def _as_law(value: Any) -> Any:
    """Return the law of a table ``[chain.law]``; other values as they are."""
    if not isinstance(value, Mapping):
        return value
    if "force" not in value:
        raise InputError.at(FORCE, 'is missing: give a formula such as "k*max(o, 0)**1.5"')
    return Law(value["force"], **{name: each for name, each in value.items() if name != "force"})


OneLaw = Annotated[InstanceOf[ContactLaw], BeforeValidator(_as_law)]


def _value(name: str, value: Any) -> Any:
    """Return a parameter as a float or a read-only array; raise `InputError` if it is neither."""
    array = numbers(value, name)
    if array.ndim > 1 or not array.size or not np.isfinite(array).all():
        raise InputError.at(name, "must be a number, or one for each contact")
    return read_only(array) if array.ndim else float(array)


def _kinks(functions: Functions, constant: Any, given: tuple[Any, ...]) -> Iterable[Any]:
    """Yield the overlap of each kink, m, and the power with which the force departs there."""
    for place, jump, jump_slope in functions.kinks:
        with np.errstate(all="ignore"):
            at = [place(x, constant, given) for x in (0.0, 1.0, -1.0, 2.0)]
            slope = np.asarray(at[1]) - at[0]
            bent = np.abs(at[1] + at[2] - 2 * np.asarray(at[0])) + np.abs(at[3] - at[0] - 2 * slope)
            if (bent > 1e-9 * (np.abs(at[0]) + np.abs(slope))).any():
                raise InputError.at(
                    FORCE,
                    "has a kink where an expression that is not linear in o is 0: "
                    "use max, min, abs and step of expressions linear in o",
                )
            if (slope == 0).all():
                continue
            where = -np.asarray(at[0]) / slope + 0.0
            power: Any = np.nan
            for side in (1.0, -1.0):
                x = side * np.where(where == 0, NEAR, RELATIVE * np.abs(where))
                size = jump(where + x, constant, given)
                here = x * jump_slope(where + x, constant, given) / size
                power = np.where(np.isfinite(power), power, here)
            if (np.asarray(size) == 0).all():
                continue
        lowest = float(np.nanmin(power)) if np.isfinite(power).any() else SMOOTH
        if lowest < 0.1:
            raise InputError.at(
                FORCE, f"jumps at o = {np.ravel(where)[0]:.3g} m: make it continuous"
            )
        if lowest < SMOOTH:
            yield (float(where) if where.ndim == 0 else where), round(lowest, 5)
