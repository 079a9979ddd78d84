"""Force laws that users write as formulas: of contacts, and of springs between grains and ground.

========  ==========  ========================================================
symbol    in formula  meaning
========  ==========  ========================================================
o         o           overlap of a contact, m; below 0 a gap or a stretched bond
K         k           constant of a contact; by default from the chain
u         u           displacement of a grain from rest, m, in a ground law
t         t           time, s, in a ground law
========  ==========  ========================================================
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from pydantic import BeforeValidator

from ..errors import InputError, shown
from ..util.arrays import EPSILON, Array, read_only
from ..util.lazy import cached_property
from ..util.tables import counted
from .contact_law import ContactLaw, RestingContacts
from .formula import MAX_NUMBER, ZERO, Formula, add, build, name, negative, number, parse

FORMULA_VARIABLES = ("o", "u", "t")
# Onset exponent that a smooth force is given, because its contacts never open.
SMOOTH = 1.5
# Number of derivatives compared on both sides of a kink.
COMPARED = 4
# Distance to a kink, relative to its overlap, at which a fractional exponent is measured.
NEAR_KINK = 1e-6
# Overlaps between which an equilibrium is sought, m.
SIZES = np.geomspace(1e-18, 1e2, 801)
# Upper bound for forces, N, and energies, J.
LARGEST = 1e300
# A value counts as reached within this relative distance.
CLOSE = 1e-6
# Number of iterations in which bisection alone finds any root.
BISECTIONS = 64
# A kink is near within this multiple of the length over which the stiffness changes.
FAR = 4.0
# Length scale of laws without one, such as a linear spring, m.
LONGEST = 1.0
NUMPY: dict[str, Any] = {
    **{
        key: getattr(np, key)
        for key in ("maximum", "minimum", "absolute", "sqrt", "exp", "log", "sin", "cos", "tanh")
    },
    "select": np.where,
    "expm1": np.expm1,
    "log1p": np.log1p,
    "growth": lambda s, p: np.expm1(p * np.log1p(np.maximum(s, -1.0))),
    "__name__": __name__,
}


# Growth factor of the pieces of an integral away from a kink, and largest number of pieces.
GROWTH = 16.0
MOST_PIECES = 20
# Number of forces of an integral that are computed at once.
VALUES_AT_ONCE = 100_000
# Largest number of iterations of a solution; bisection alone needs fewer.
ITERATIONS = 2000
WIDEN = 1e3  # Largest factor between two values of x.
# Overlaps, relative to the largest one, at which the largest stiffness is searched. A law that
# saturates is stiffest at overlaps that may be a tiny part of the largest one.
PARTS = np.linspace(0.0, 1.0, 33)[1:]
TINY_PARTS = 2.0 ** np.arange(-48, -5)

# Number of overlaps between which the largest force of a law that decreases is searched.
SCANNED = 1001


def _smooth_rule(size: int = 24) -> Array:
    """Return nodes from 0 to 1 and weights of a quadrature rule, (2, size).

    A smooth step of order 4 moves Gauss's nodes towards both ends, so that fractional powers of the
    distance to an end are integrated accurately.
    """
    nodes, weights = leggauss(size)
    t = (nodes + 1) / 2
    step = t**4 * (35 - 84 * t + 70 * t**2 - 20 * t**3)
    return np.array([step, weights / 2 * 140 * t**3 * (1 - t) ** 3])


RULE = _smooth_rule()
# Integrals by this rule differ from those by `RULE` by about the square root of the error of those.
CHECK = _smooth_rule(12)
SETTLED = 3e-6
# Largest number of parts into which a piece of an integral is divided until both rules agree.
MOST_PARTS = 256


def solve_growing(
    function: Callable[[Array], Array], slope: Callable[[Array], Array], target: Any, start: Any
) -> Array:
    """Return the x >= 0 at which a function that grows from 0 has this value; infinite if none.

    Newton's method is used for the logarithms, which finds the root of a power in one step. Where
    a step leaves the bracket, the logarithm is bisected, or x grows by `WIDEN` if it has no upper
    bound yet. For the value 0 or infinity the value itself is returned.
    """
    target = np.asarray(target)
    with np.errstate(all="ignore"):
        known = np.isfinite(target) & (target > 0)
        x = np.where(known, np.maximum(start, 1e-300), 0)
        low = np.zeros_like(x)
        high = np.where(known, np.inf, 0)
        for _ in range(ITERATIONS):
            value = function(x)
            low = np.where(value < target, x, low)
            high = np.where(value < target, high, x)
            step = x * (target / value) ** (value / (x * slope(x)))
            middle = np.sqrt(np.maximum(low, high / WIDEN**2)) * np.sqrt(high)
            farther = np.minimum(WIDEN * x, LARGEST)
            other = np.where(np.isfinite(high), middle, farther)
            new = np.where((low <= step) & (step <= np.minimum(high, farther)), step, other)
            if not (known & (np.abs(new - x) > 2 * np.finfo(x.dtype).eps * x)).any():
                break
            x = new
        # A force that saturates never reaches some values, and overflows on the way there.
        reached = np.abs(function(new) - target) <= CLOSE * target
        if not reached[known].all():
            reached |= function(np.where(np.isfinite(high), high, new)) >= target
        return np.where(known, np.where(reached, new, np.inf), target)


def _pieces(rest: Array, r: Array, kinks: Array) -> Array:
    """Return the ends of pieces of the interval from 0 to r, ascending, (P+1, ...) m.

    The pieces end at kinks. Pieces far from a kink are longer.
    """
    ends: list[Any] = [0 * r, r]
    for kink in kinks:
        far = np.abs(rest - kink)
        ratio = np.max(np.abs(r) / np.where(far > 0, far, np.inf), initial=1.0)
        growth = GROWTH ** np.arange(1, 1 + int(min(math.log(ratio, GROWTH), MOST_PIECES))) - 1
        ends += [kink - rest, *(np.sign(r) * far * times for times in growth)]
    return np.sort(np.clip(ends, np.minimum(r, 0), np.maximum(r, 0)), axis=0)


def _summed(
    function: Callable[[Array], Array], ends: Array, rule: Array, parts: int = 1
) -> tuple[Array, Array]:
    """Return the integral of a function over all pieces, and that of its absolute value.

    Parameters
    ----------
    function : function
        Function of (n, ...) places.
    ends : (P+1, ...) array
        Ends of the pieces, ascending.
    rule : (2, n) array
        Nodes and weights from 0 to 1.
    parts : int
        Number of equal parts into which each piece is divided.
    """
    total = np.zeros(ends.shape[1:])
    size = np.zeros(ends.shape[1:])
    nodes = rule.shape[1]
    count = min(math.ceil(nodes * total.size / VALUES_AT_ONCE) or 1, nodes)
    groups = np.array_split(rule.reshape(2, -1, *[1] * total.ndim), count, axis=1)
    for begin, whole in zip(ends[:-1], np.diff(ends, axis=0), strict=True):
        # Most kinks are outside the interval.
        if not whole.any():
            continue
        width = whole / parts
        for part in range(parts):
            for places, weights in groups:
                values = weights * width * function(begin + (part + places) * width)
                total = total + values.sum(axis=0)
                size = size + np.abs(values).sum(axis=0)
    return total, size


class Law(ContactLaw):
    """The force of a contact, or of a spring to the ground, given by a formula.

    Two laws are equal if their printed formulas and their parameters are equal.

    Parameters
    ----------
    force : str
        Formula of the force, N. A contact law is the force that pushes two grains apart, as a
        function of the overlap ``o``, m; ``o < 0`` is a gap, or a stretched bond if the force is
        not 0 there. A ground law is the force that pulls a grain back, as a function of its
        displacement ``u`` from rest, m, and of the time ``t``, s. `lmpchain.chain.formula` lists
        the operations and functions that a formula may contain.
    **parameters : float or (N-1,) array
        Values of the other names in the formula, for all contacts or for each contact (in a ground
        law, for each grain). If ``k`` is not given, it is the contact constant of the chain. A wall
        contact has the parameters of the adjacent contact.

    Raises
    ------
    InputError
        With the key ``force`` or the name of a parameter, if one of them is not valid.

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
        needed = [key for key in names if key not in FORMULA_VARIABLES]
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
        force, stiffness, curvature = map(self._function, _derived(formula))
        super().__init__(
            force,
            stiffness,
            curvature,
            onset=SMOOTH,
            parameters=tuple(_array(given[key]) for key in self.names),
            name=self.text,
        )
        object.__setattr__(self, "onset", self._onset())

    def _function(self, part: Formula) -> Callable[..., Any]:
        """Return a function of overlap, constant and parameters that evaluates a formula."""
        arguments = {key: f"p[{n}]" for n, key in enumerate(self.names)}
        # In a ground law the time replaces the constant of a contact.
        variables = "u, t, p" if self.of_ground else "o, k, p"
        return part.function(variables, NUMPY, arguments)

    @property
    def kernel(self) -> LawKernel:
        """The law prepared for compilation, equal for all values of the parameters."""
        return _kernel(self.formula, tuple(self.names))

    def kinks(self, constant: Any) -> Array:
        """Return where the force is not smooth, in overlap or displacement, (K, ...) m.

        Every contact has its own kinks. `LARGEST` stands for a kink that no motion reaches.
        """
        constant = np.asarray(constant, dtype=float)
        parameters = [np.asarray(value, dtype=float) for value in self.parameters]
        shape = np.broadcast_shapes(constant.shape, *(value.shape for value in parameters))
        rows = np.zeros((0, *shape))
        with np.errstate(all="ignore"):
            for place in _kink_functions(self.formula, tuple(self.names), self.of_ground):
                row = np.broadcast_to(place(constant, parameters), shape)
                row = np.where(np.abs(row) < LARGEST, row, LARGEST)
                if not any(np.array_equal(row, other) for other in rows):
                    rows = np.concatenate((rows, row[None]))
        return rows if shape else np.sort(rows)

    def kept_at_rest(self, overlap: Any, constant: Any) -> list[Any]:
        """Return the values at rest that the compiled change of the force reads."""
        with np.errstate(all="ignore"):
            return [function(overlap, constant, self.parameters) for function in self.kernel.kept]

    @property
    def names(self) -> list[str]:
        """Names of the parameters except k, in the order of `parameters`."""
        return [key for key in self.given if key != "k" or self.of_ground]

    @property
    def text(self) -> str:
        """The formula as text; parsing it gives the same law."""
        return self.formula.text

    @cached_property
    def of_ground(self) -> bool:
        """Whether the law describes a ground, as a function of displacement and time."""
        return any(key in self.formula.names for key in ("u", "t"))

    def _change(self, rest: Array, r: Array, constant: Array) -> Array:
        """Return F(rest + r) - F(rest) without loss of relative accuracy for small r, N."""
        with np.errstate(all="ignore"):
            change = self.kernel.change(rest, r, constant, self.parameters)
        return np.broadcast_to(change, np.broadcast_shapes(np.shape(rest), np.shape(r)))

    def _integral(self, rest: Array, r: Array, constant: Array, kinks: Array) -> Array:
        """Return an estimate of the integral of F(rest + s) - F(rest) over s from 0 to r, J."""
        rest, r, constant = np.broadcast_arrays(rest, r, constant)
        pieces = _pieces(rest, r, kinks)
        return np.sign(r) * _summed(lambda s: self._change(rest, s, constant), pieces, RULE)[0]

    def _exact_integral(
        self, force: Callable[[Array], Array], rest: Array, r: Array, constant: Array
    ) -> Array:
        """Return the integral of a force over s from 0 to r, J, accurate unless it oscillates."""
        pieces = _pieces(rest, r, self.kinks(constant))
        parts = 1
        with np.errstate(all="ignore"):
            while True:
                total, size = _summed(force, pieces, RULE, parts)
                check, _ = _summed(force, pieces, CHECK, parts)
                if parts == MOST_PARTS or not (np.abs(total - check) > SETTLED * size).any():
                    return np.sign(r) * total
                parts *= 2

    def force_change(self, contacts: RestingContacts, r: Array) -> Array:
        """Return the change of force for a change r of the overlap, (..., N+1) N."""
        return self._change(contacts.overlap, r, contacts.constant)

    def energy_change(self, contacts: RestingContacts, r: Array) -> Array:
        """Return the contact energy above that at rest for a change r of the overlap, (..., N+1) J.

        It is the integral of the change of force over r.
        """
        rest, r, constant = np.broadcast_arrays(contacts.overlap, r, contacts.constant)
        return self._exact_integral(lambda s: self._change(rest, s, constant), rest, r, constant)

    def squeezed_by(self, contacts: RestingContacts, force: Any) -> Any:
        """Return the increase of overlaps under an additional force, m."""
        return solve_growing(
            lambda r: self.force_change(contacts, r),
            lambda r: self.stiffness(contacts.overlap + r, contacts.constant),
            np.asarray(force),
            (force / contacts.constant) ** (1 / self.onset),
        )

    def _numbers(self, contact: int, constant: float = 1.0) -> dict[str, float]:
        """Return the parameters of one contact by name."""
        values = {"k": constant}
        for key, value in self.given.items():
            values[key] = value[contact] if isinstance(value, tuple) else value
        return values

    def _onset(self) -> float:
        """Return the lowest power of the distance to any kink at which the two sides differ."""
        # Parameters that differ between contacts may change the power, so contacts with extreme
        # values are checked.
        arrays = [value for value in self.given.values() if isinstance(value, tuple)]
        contacts = {0} | {f(value) for value in arrays for f in (np.argmin, np.argmax)}
        powers = [SMOOTH] if not self.formula.kinks("o") else []
        for values in map(self._numbers, sorted(map(int, contacts))):
            whole = self.formula.substitute(values)
            powers += bend_powers(whole, self.formula.kinks("o"), values, "o")
        return min(powers, default=SMOOTH)

    def with_parameters(self, parameters: Iterable[Any]) -> Law:
        """Return the law with other numbers or arrays for `parameters`."""
        law = object.__new__(Law)
        law.__dict__.update(
            {key: value for key, value in self.__dict__.items() if key in KEPT_FIELDS}
        )
        object.__setattr__(law, "parameters", tuple(parameters))
        return law

    def _constant(self, constant: Any) -> Any:
        if constant is not None:
            return constant
        if self.of_ground:
            return 0.0
        if "k" in self.given:
            return np.asarray(self.given["k"])
        if "k" in self.formula.names:
            raise InputError.at("k", "is not given: pass it as an argument")
        return 1.0

    def _filled(self, function: Any, overlap: Any, constant: Any) -> Any:
        """Return the values of a function, broadcast to overlaps, constants and parameters."""
        constant = np.asarray(self._constant(constant))[()]
        overlap = np.asarray(overlap)[()]
        shape = np.broadcast_shapes(*map(np.shape, (overlap, constant, *self.parameters)))
        with np.errstate(all="ignore"):
            values = function(overlap, constant)
        return values if np.shape(values) == shape else np.broadcast_to(values, shape)

    def force(self, overlap: Any, constant: Any = None) -> Any:
        """Return the force at an overlap, N; of a ground law, at a displacement and a time, s."""
        return self._filled(super().force, overlap, constant)

    def stiffness(self, overlap: Any, constant: Any = None) -> Any:
        """Return the derivative of the force with respect to the overlap, N/m."""
        return self._filled(super().stiffness, overlap, constant)

    def force_slope(self, key: str, overlap: Any, constant: Any = None) -> Any:
        """Return the derivative of the force with respect to the parameter of this name."""
        slope = self._function(self.formula.derivative(key))
        return self._filled(lambda o, k: slope(o, k, self.parameters), overlap, constant)

    def curvature(self, overlap: Any, constant: Any = None) -> Any:
        """Return the second derivative of the force with respect to the overlap, N/m2."""
        return self._filled(super().curvature, overlap, constant)

    def overlap(self, force: Any, constant: Any = None) -> Any:
        """Return the overlap at which a contact is at rest under this force, m.

        Without a force it is 0, if the law has no force and no negative stiffness at overlap 0.

        Raises
        ------
        InputError
            If the law reaches this force with a positive slope at no overlap, or at more than one.
        """
        columns = np.broadcast_arrays(force, self._constant(constant), *self.parameters)
        shape = columns[0].shape
        forces, *others = (np.ravel(column).astype(float) for column in columns)
        contacts, inverse = np.unique(np.array(others), axis=1, return_inverse=True)
        overlaps = np.zeros(forces.size)
        # The contacts of a long chain share one constant but have many forces.
        order = np.argsort(inverse.ravel(), kind="stable")
        ends = np.searchsorted(inverse.ravel()[order], np.arange(contacts.shape[1] + 1))
        for number_, values in enumerate(contacts.T):
            chosen = order[ends[number_] : ends[number_ + 1]]
            alone = self.with_parameters(values[1:])
            overlaps[chosen] = alone._rest(forces[chosen], float(values[0]))
        return overlaps.reshape(shape)[()]

    def _rest(self, forces: Array, constant: float) -> Array:
        """Return the overlaps of equal contacts under given forces, (C,) m."""
        places, values = self._sampled(constant)
        low, high = np.zeros((2, forces.size))
        at_zero = self.force(0.0, constant), self.stiffness(0.0, constant)
        touches = (forces == 0.0) & (at_zero[0] == 0.0) & (at_zero[1] >= 0.0)
        if (np.diff(values) >= 0).all():
            after = np.searchsorted(values, forces, side="right")
            before = np.searchsorted(values, forces, side="left") - 1
            unique = (before >= 0) & (after < values.size)
            if not (unique | touches).all():
                raise self._no_rest(float(forces[~(unique | touches)][0]), constant, 0)
            low, high = places[np.maximum(before, 0)], places[np.minimum(after, values.size - 1)]
        else:
            for n in np.flatnonzero(~touches):
                signs = np.sign(values - forces[n])
                near = np.flatnonzero(signs)
                rises = np.flatnonzero(np.diff(signs[near]) > 0)
                if rises.size != 1:
                    raise self._no_rest(float(forces[n]), constant, rises.size)
                low[n], high[n] = places[near[rises[0]]], places[near[rises[0] + 1]]
        return np.where(touches, 0.0, self._refined(low, high, forces, constant))

    def _no_rest(self, force: float, constant: float, count: int) -> InputError:
        if count:
            fault = f"has {count} equilibria under {force:g} N: change load or gravity"
        elif force == 0.0 and np.isnan(self.stiffness(0.0, constant)).any():
            cure = "use powers such as max(o, 0)**1.5 in place of roots and logarithms of 0"
            fault = f"has an undefined stiffness at an overlap of 0: {cure}"
        else:
            fault = f"has no equilibrium under {force:g} N: its force does not reach this value"
        return InputError.at("law", f"{fault} ({self.text})")

    def _refined(self, low: Array, high: Array, forces: Array, constant: float) -> Array:
        """Return the overlaps in a bracket at which the force has these values (Newton)."""
        x = (low + high) / 2
        for _ in range(BISECTIONS):
            off = self.force(x, constant) - forces
            low = np.where(off < 0, x, low)
            high = np.where(off < 0, high, x)
            with np.errstate(all="ignore"):
                step = x - off / self.stiffness(x, constant)
            new = np.where((low <= step) & (step <= high), step, (low + high) / 2)
            # Rounding may move the last step out of the bracket.
            new = np.where(np.abs(off) <= 4 * EPSILON * np.abs(forces), x, new)
            if not (np.abs(new - x) > 2 * EPSILON * np.abs(x)).any():
                return new
            x = new
        return x

    def _sampled(self, constant: float) -> tuple[Array, Array]:
        """Return overlaps of every size and the kinks, ascending, m, and the forces there, N."""
        kinks = self.kinks(constant)
        kinks = kinks[np.abs(kinks) < LARGEST]
        places = np.unique(np.concatenate((-SIZES, [0.0], SIZES, kinks)))
        # Infinite forces are replaced by the largest allowed force.
        values = np.clip(self.force(places, constant), -LARGEST, LARGEST)
        sound = ~np.isnan(values)
        return places[sound], values[sound]

    @property
    def kinds(self) -> Array:
        """The parameters and, in the last row, the constants of all kinds of contacts, (P+1, C).

        Of contacts that differ only in their constants, only the extreme ones are listed.
        """
        # Contacts of a chain have stored them.
        if "_kinds" in self.__dict__:
            return np.asarray(self.__dict__["_kinds"])
        values = [self.given[key] for key in self.names]
        return _extremes(*values, self.given.get("k", 1.0))

    def with_constants(self, constant: Array) -> Law:
        """Return the law of contacts with these constants, (..., N+1); 0 for missing walls."""
        in_formula = constant if "k" in self.formula.names else 1.0
        columns = np.broadcast_arrays(*self.parameters, in_formula, constant > 0)
        law = self.with_parameters(self.parameters)
        law.__dict__["_kinds"] = _extremes(*(x[columns[-1]] for x in columns[:-1]))
        return law

    @cached_property
    def _shape(self) -> tuple[bool, bool, bool]:
        """Whether contacts pull, whether the force is non-decreasing, and whether contacts bond."""
        pulls, grows, bonds = False, True, True
        for *values, constant in self.kinds.T:
            alone = self.with_parameters(values)
            places, force = alone._sampled(constant)
            pulls |= bool((force[places < 0] != 0).any())
            grows &= bool((np.diff(force) >= 0).all())
            try:
                rest = alone._rest(np.zeros(1), constant)
            except InputError:
                bonds = False
                continue
            stiffness = alone.stiffness(rest, constant)[0]
            bonds &= 0 < stiffness < np.inf and rest[0] not in alone.kinks(constant)
        return pulls, grows, pulls and bonds

    @property
    def pulls(self) -> bool:
        """Whether contacts exert a force across a gap."""
        return self._shape[0]

    @property
    def grows(self) -> bool:
        """Whether the force decreases at no overlap."""
        return self._shape[1]

    @property
    def bonds(self) -> bool:
        """Whether contacts are stiff at rest without any load."""
        return self._shape[2]

    @property
    def as_exponent(self) -> float | None:
        """The exponent if the formula equals the chain's built-in power law; None otherwise."""
        if "k" in self.given or self.formula.operation != "*":
            return None
        constant, raised = self.formula.parts
        base = raised.parts[0] if raised.operation == "**" else raised
        exponent = raised.parts[1].number if raised.operation == "**" else 1.0
        plain = constant is name("k") and base is build("max", name("o"), ZERO)
        return exponent if plain and exponent and 1 <= exponent <= 3 else None

    @property
    def given_constant(self) -> Array | None:
        """The constants of contacts given by the law itself; None if it gives none."""
        k = self.given.get("k")
        return None if k is None else np.array(k, ndmin=1)

    def with_walls(self, grains: int) -> Law:
        """Return the law with parameters of all contacts, walls included, (N+1,) arrays."""
        # A wall contact has the parameters of the contact next to it; a single grain has only
        # walls.
        index = np.clip(np.arange(grains + 1) - 1, 0, max(grains - 2, 0))
        return self.of(index)

    def of(self, numbers: Any, dimensions: int = 1) -> Law:
        """Return the law of a selection of contacts, or of chains (see `ContactLaw.of`)."""
        if all(np.ndim(value) != dimensions for value in self.parameters):
            return self
        return self.with_parameters(
            value[numbers] if np.ndim(value) == dimensions else value for value in self.parameters
        )

    @property
    def form(self) -> Any:
        """A key that is equal for laws that differ only in parameter values."""
        return self.formula, tuple(self.names), self.onset

    def joined(self, laws: Sequence[ContactLaw]) -> Law:
        """Return the common law of many chains, with a row of every parameter for each chain."""
        rows = []
        for values in zip(*(law.parameters for law in laws), strict=True):
            width = max(map(np.size, values))
            rows.append(np.array([np.broadcast_to(value, width) for value in values]))
        common = self.with_parameters(map(read_only, rows))
        common.__dict__["_kinds"] = _extremes(
            *np.hstack([law.kinds for law in laws if isinstance(law, Law)])
        )
        return common

    def part(self, first: int, last: int) -> Law:
        """Return the law of grains `first` to `last` of a chain."""
        if not any(isinstance(value, tuple) for value in self.given.values()):
            return self
        return self.replace(
            **{
                key: value[first - 1 : last - (not self.of_ground)]
                for key, value in self.given.items()
                if isinstance(value, tuple)
            }
        )

    def of_grains(self, grains: Any) -> Law:
        """Return the law of a ground under these grains, (G,), counted from 1."""
        columns = np.asarray(grains) - 1
        return self.with_parameters(
            value[columns] if np.ndim(value) else value for value in self.parameters
        )

    def pressed(self, contacts: RestingContacts) -> NDArray[np.bool_]:
        """Return whether a contact is stiff at rest, and not at a kink of its force, (..., N+1)."""
        stiff = contacts.exists & (contacts.stiffness > 0) & np.isfinite(contacts.stiffness)
        for kink in self.kinks(contacts.constant):
            stiff &= contacts.overlap != kink
        return stiff

    def length(self, contacts: RestingContacts) -> Array:
        """Return the change of overlap at which a wave is no longer weak, (..., N+1) m.

        It is the distance to the nearest kink, or the length over which the first or the second
        derivative of the stiffness changes the stiffness by its own value, if that is smaller.
        """
        constant = np.where(contacts.exists, contacts.constant, 1.0)
        length = np.full(contacts.overlap.shape, LONGEST)
        kinks = self.kinks(constant)
        for kink in kinks:
            length = np.minimum(length, np.abs(contacts.overlap - kink))
        with np.errstate(all="ignore"):
            k = self.stiffness(contacts.overlap, constant)
            bend = np.abs(self.curvature(contacts.overlap, constant)) / k
            third = _third_derivative(self.formula, tuple(self.names))
            twist = np.sqrt(np.abs(third(contacts.overlap, constant, self.parameters)) / (2 * k))
            # Below a kink, fractional powers of the distance to it also change the stiffness.
            far = FAR if len(kinks) else 1.0
            length = np.fmin(length, far * np.fmin(1 / bend, 1 / twist))
            if (length < LONGEST).all() or "o" not in self.formula.derivative("o").names:
                return length
            # Only higher derivatives change the stiffness, as in o + o**5 at o = 0.
            for size in LONGEST * 2.0 ** -np.arange(1, 60):
                for side in (-size, size):
                    change = np.abs(self.stiffness(contacts.overlap + side, constant) - k)
                    length = np.where(2 * change > k, np.minimum(length, size), length)
            return length

    def hardening(self, contacts: RestingContacts, strain: float) -> float:
        """Return the largest relative change of the mean stiffness over ``eps - r ... eps + r``.

        In symmetric contacts, it changes the frequency of waves although the stiffness has no slope
        at rest. The change r is at most the strain times `length`. If the result is smaller for
        smaller r, it is at least proportional to r^2.
        """
        largest = 0.0
        for part in (0.25, 0.5, 1.0):
            r = part * strain * contacts.length
            with np.errstate(all="ignore"):
                ends = [self._change(contacts.overlap, x, contacts.constant) for x in (-r, r)]
                change = np.abs((ends[1] - ends[0]) / (2 * r * contacts.stiffness) - 1)
            change = np.where(contacts.pressed & (change > 16 * EPSILON), change, 0.0)
            largest = max(largest, float(change.max()) / part**2)
        return largest

    def largest_stiffness(self, overlap: Any, constant: Any) -> Any:
        """Return the largest stiffness at any overlap up to this size, N/m."""
        largest = self._stiffest(overlap, constant)
        if self.pulls:
            largest = np.fmax(largest, self._stiffest(-overlap, constant))
        return largest

    def _stiffest(self, end: Any, constant: Any) -> Any:
        """Return the largest stiffness between overlap 0 and an overlap of either sign, N/m."""
        end = np.clip(end, -SIZES[-1], SIZES[-1])
        # Below an infinite stiffness, smaller overlaps would be stiffer without limit.
        parts = PARTS if self.onset < 1 else np.append(TINY_PARTS, PARTS)
        # Large arrays are processed in several groups of parts.
        groups = min(math.ceil(parts.size * np.size(end) / VALUES_AT_ONCE) or 1, parts.size)
        largest = self.stiffness(end, constant)
        for group in np.array_split(parts, groups):
            values = self.stiffness(np.multiply.outer(group, end), constant)
            largest = np.fmax(largest, np.fmax.reduce(values, axis=0))
        for kink in self.kinks(constant):
            inside = (kink * np.sign(end) > 0) & (np.abs(kink) < np.abs(end))
            largest = np.fmax(largest, np.where(inside, self.stiffness(kink, constant), 0.0))
        return largest

    def approach(self, energy: Any, constant: Any) -> Any:
        """Return the change of overlap at which a contact stores this energy, m.

        It is that of a closing contact, or of a stretched one if that is longer and stiffer. The
        energy is measured from rest without a load.
        """
        energy, constant = np.broadcast_arrays(energy, constant)
        rest = np.zeros(energy.shape)
        if self.bonds:
            rest = rest + self.overlap(np.zeros(energy.shape), constant)
        closed = rest + self._extent(energy, constant, rest, 1.0)
        # An attraction that ends or decreases may store less energy at any stretch of the contact.
        if not (self.pulls and self._shape[1]):
            return closed
        stretched = self._extent(energy, constant, rest, -1.0)
        stiffer = self._stiffest(-stretched, constant) > self._stiffest(closed, constant)
        return np.where(stiffer, np.maximum(closed, stretched), closed)

    def approach_bound(self, contacts: RestingContacts, energy: Any) -> Any:
        """Return an upper bound on the change of overlaps from rest, m.

        The bound is infinite if the force decreases anywhere, because a contact may then receive
        unlimited energy from other contacts.
        """
        shape = np.broadcast_shapes(np.shape(energy), contacts.constant.shape)
        if not self._shape[1]:
            return np.full(shape, np.inf)
        constant = np.where(contacts.exists, contacts.constant, 1.0)
        given, constant, rest = (
            np.broadcast_to(x, shape) for x in (energy, constant, contacts.overlap)
        )
        bound = self._extent(given, constant, rest, 1.0)
        if self.pulls:
            bound = np.maximum(bound, self._extent(given, constant, rest, -1.0))
        return bound

    def largest_force(self, first: float, closest: float, constant: float) -> tuple[float, float]:
        """Return the largest force of one contact in a motion, and an upper bound on it, N.

        The motion passes all overlaps from the first to the closest one, and perhaps smaller ones.
        The law has the parameters of this contact.

        Parameters
        ----------
        first, closest : float
            Overlap at t = 0, and the largest overlap of the motion, m.
        constant : float
            Constant of the contact.
        """
        kinks = self.kinks(constant).ravel()
        inside = kinks[(first < kinks) & (kinks < closest)]
        places = np.union1d(np.linspace(first, closest, SCANNED), inside)
        values = np.ravel(self.force(places, constant))
        best = int(np.nanargmax(values))
        largest = float(values[best])
        low, high = places[max(best - 1, 0)], places[min(best + 1, places.size - 1)]
        if low < high:
            from scipy.optimize import minimize_scalar

            def pull(x: float) -> float:
                return -float(np.ravel(self.force(x, constant))[0])

            exact = {"xatol": 1e-9 * (high - low)}
            found = minimize_scalar(pull, bounds=(low, high), method="bounded", options=exact)
            largest = max(largest, -float(found.fun))
        everywhere, possible = self._sampled(constant)
        return largest, max(largest, float(possible[everywhere <= closest].max(initial=-np.inf)))

    def _extent(self, energy: Array, constant: Array, rest: Array, side: float) -> Array:
        """Return the closing (side 1) or stretch (side -1) at which a contact has this energy, m.

        It is infinite if the energy has no upper bound, as in a forced motion.
        """
        energy = np.where(energy < LARGEST, energy, np.inf)
        kinks = self.kinks(constant)
        with np.errstate(all="ignore"):
            k = np.abs(self.stiffness(rest, constant))
            start = np.sqrt(energy / np.where((k > 0) & np.isfinite(k), k, constant))
            return solve_growing(
                lambda r: self._integral(rest, side * r, constant, kinks),
                lambda r: side * self._change(rest, side * r, constant),
                energy,
                start,
            )

    def energy(self, overlap: Any, constant: Any = None) -> Any:
        """Return the integral of the force over the overlap from 0, J."""
        overlap = np.asarray(overlap, dtype=float)
        constant = self._constant(constant)
        shape = np.broadcast_shapes(
            overlap.shape, np.shape(constant), *map(np.shape, self.parameters)
        )
        overlap, constant = (np.broadcast_to(x, shape) for x in (overlap, constant))
        return self._exact_integral(
            lambda o: self.force(o, constant), np.zeros(shape), overlap, constant
        )[()]

    def lepton(
        self,
        what: str = "energy",
        overlap: str = "-r",
        constant: float | None = None,
        contact: int = 0,
    ) -> str:
        """Return the force or energy of one contact as a LEPTON formula with numbers inserted.

        Parameters
        ----------
        what : "energy" or "force"
            Quantity that the formula computes.
        overlap : str
            Formula that replaces the overlap o, for example with the distance ``r``. In a ground
            law it replaces the displacement u.
        constant : float, optional
            Contact constant K; by default the constant that the law itself contains.
        contact : int
            Index of the contact whose parameters are used, from 0.

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
                raise InputError.at("force", f"{fault}: use the native engine")
            formula = energy
        return formula.substitute({variable: parse(overlap)}).lepton

    def table(self) -> dict[str, Any]:
        """Return the formula and parameters as a table of a scene file."""
        return {"force": self.text} | {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in self.given.items()
        }

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Law:
        """Return the law that a table of a scene file defines (see `table`)."""
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


@dataclass(frozen=True, eq=False)
class LawKernel:
    """Functions derived from one formula that do not depend on the values of its parameters.

    Attributes
    ----------
    force_change, stiffness : Formula
        Change of the force for a change ``r`` of the overlap, and stiffness at ``o + r``. They
        contain the names ``r``, ``o`` and ``k``, ``_p0`` ... for the parameters, and ``_q0`` ...
        for the values stored at rest.
    codes : mapping
        Index expression of each name in an array with a column for each contact: ``given[0, n]`` is
        o.
    change : function
        Function of (o, r, k, p) for the change of the force.
    kept : list of functions
        Functions of (o, k, p) for the values stored at rest.
    """

    force_change: Formula
    stiffness: Formula
    codes: dict[str, str]
    change: Any
    kept: list[Any]


@cache
def _kernel(formula: Formula, names: tuple[str, ...]) -> LawKernel:
    # No parameter of a user begins with an underscore, but one may be called r.
    own = [f"_p{n}" for n in range(len(names))]
    renamed = formula.substitute(dict(zip(names, map(name, own), strict=True)))
    force, stiffness, _ = _derived(renamed)
    change = force.change("o", "r")
    inner, kept = change.without(["o", "k", *own], "_q")
    parameters = {key: f"p[{n}]" for n, key in enumerate(own)}
    columns = ["o", "k", *own, *(f"_q{n}" for n in range(len(kept)))]
    return LawKernel(
        inner,
        stiffness.substitute({"o": add(name("o"), name("r"))}),
        {key: f"given[{n}, n]" for n, key in enumerate(columns)},
        change.function("o, r, k, p", NUMPY, parameters),
        [part.function("o, k, p", NUMPY, parameters) for part in kept],
    )


@cache
def _derived(formula: Formula) -> tuple[Formula, Formula, Formula]:
    """Return the force, stiffness and curvature, or 0 for missing contacts (constant 0)."""
    force = formula
    if "o" not in formula.names:
        stiffness = force.derivative("u")
        return force, stiffness, stiffness.derivative("u")
    if force.substitute({"k": 0.0}) is not ZERO:
        force = build("select", negative(name("k")), ZERO, force)
    # An infinite stiffness times a constant of 0 would be NaN.
    stiffness = build("select", negative(name("k")), ZERO, force.derivative("o"))
    return force, stiffness, stiffness.derivative("o")


@cache
def _third_derivative(formula: Formula, names: tuple[str, ...]) -> Callable[..., Any]:
    """Return a function of (o, k, p) for the third derivative of the force, N/m3."""
    arguments = {key: f"p[{n}]" for n, key in enumerate(names)}
    return _derived(formula)[2].derivative("o").function("o, k, p", NUMPY, arguments)


def _misfits(
    names: list[str], needed: list[str], parameters: Mapping[str, Any]
) -> Iterable[tuple[str, str]]:
    """Yield missing, unknown and misnamed parameters of a formula."""
    if "o" in names and ("u" in names or "t" in names):
        yield "force", "contains both o (of a contact) and u or t (of the ground): use one kind"
    if "o" not in names and "u" not in names:
        yield "force", "depends on neither the overlap o nor the displacement u"
    if "force" in needed:
        yield "force", "has a parameter named force: give it another name"
    for key in needed:
        if key not in parameters and (key != "k" or "o" not in names):
            yield key, f"is not given: the formula needs a number, {key} = ..."
    for key in parameters:
        if key in FORMULA_VARIABLES:
            yield key, "is a variable of formulas: give the parameter another name"
        elif key not in needed:
            known = ", ".join(needed) or "none"
            yield key, f"is not in the formula: its parameters are {known}"


def _number(key: str, value: Any) -> float | tuple[float, ...]:
    """Return a parameter value as a number, or as a tuple of numbers."""
    try:
        array = np.asarray(value)
        sound = array.dtype.kind in "iuf" and array.ndim <= 1 and array.size > 0
        array = array.astype(float) if sound else array
    except (ValueError, TypeError):
        sound = False
    if not sound:
        raise InputError.at(key, "must be a number, or a list with one number for each contact")
    if not (np.abs(array) <= MAX_NUMBER).all():
        raise InputError.at(key, f"must be finite, and no more than {MAX_NUMBER:g}")
    if array.ndim == 0:
        return float(array)
    return tuple(array.tolist())


def _array(value: float | tuple[float, ...]) -> float | Array:
    # Python raises an error if it divides by a float of 0, where NumPy returns infinity.
    return read_only(np.array(value)) if isinstance(value, tuple) else np.float64(value)


def _shown(value: float | tuple[float, ...]) -> str:
    if isinstance(value, tuple):
        return counted(len(value), "number")
    return number(value).text


@cache
def _kink_functions(formula: Formula, names: tuple[str, ...], of_ground: bool) -> list[Any]:
    """Return functions of (k, p) that compute the kinks of a formula, m."""
    arguments = {key: f"p[{n}]" for n, key in enumerate(names)}
    kinks = formula.kinks("u" if of_ground else "o")
    return [place.function("k, p", NUMPY, arguments) for place in kinks]


def bend_powers(
    formula: Formula, places: Sequence[Formula], values: Mapping[str, float], variable: str
) -> list[float]:
    """Return the powers of the distance with which a formula bends at its kinks (see `_bend_at`).

    The formula contains no name except the variable. `places` are the kinks as formulas, and
    `values` are the values of the names in these formulas.
    """
    kinks = {place.substitute(values).number for place in places}
    return [_bend_at(formula, kink, variable) for kink in kinks if kink is not None]


def _bend_at(formula: Formula, kink: float, variable: str) -> float:
    """Return the lowest power of the distance to a kink in which its two sides differ.

    The power is 0 at a jump of the force, and 1 at a jump of the stiffness.
    """
    distance = NEAR_KINK * abs(kink) or 1e-40
    below, above = (formula.between_kinks(variable, kink + side) for side in (-distance, distance))
    for order in range(COMPARED):
        difference = above.value_at(variable, kink) - below.value_at(variable, kink)
        if not math.isfinite(difference):
            near, far = (
                above.value_at(variable, kink + d) - below.value_at(variable, kink + d)
                for d in (distance, 16 * distance)
            )
            grows = math.log(abs(far / near), 16) if near and far else 0.0
            return round(order + max(grows, -1.0), 6)
        scale = abs(above.value_at(variable, kink)) + abs(below.value_at(variable, kink))
        if abs(difference) > 1e-9 * scale:
            return float(order)
        below, above = below.derivative(variable), above.derivative(variable)
    return float(COMPARED)


KEPT_FIELDS = (*ContactLaw.__dataclass_fields__, "formula", "given", "_kinds")


def _extremes(*rows: Any) -> Array:
    """Return the distinct columns of these rows, (R, C).

    Of columns that differ only in the last row, only the two extreme ones are returned.
    """
    columns = np.unique([np.ravel(row) for row in np.broadcast_arrays(*rows)], axis=1)
    differs = (columns[:-1, 1:] != columns[:-1, :-1]).any(axis=0)
    return columns[:, np.append(True, differs) | np.append(differs, True)]


def _law(value: Any) -> Any:
    """Return a law from its table in a scene file; return other values unchanged."""
    if isinstance(value, Mapping):
        return Law.from_table(value)
    if not isinstance(value, ContactLaw):
        cure = 'use lmpchain.Law("k*max(o, 0)**1.5"), or {"force": "k*max(o, 0)**1.5"}'
        raise ValueError(f"is not a law (got {shown(value)}): {cure}")
    return value


OneLaw = Annotated[ContactLaw, BeforeValidator(_law)]
