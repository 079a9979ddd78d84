"""Power through a contact of a chain driven at one frequency, compared with the power input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from ..chain.chain import Chain
from ..errors import InputError
from ..scene.acting import Drive, Force
from ..theory.steady import displacements, dynamic_stiffness
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array, whole_numbers
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import COLOURS, Axes, chart, finish, prefixed
from ..util.tabular import Tabular
from .bodies import motion
from .contact import contacts, force_above_rest
from .harmonic import amplitudes, averaged_periods, harmonic_drive, transient
from .motion import motion_of

__dir__ = listed(__name__)

SAMPLES = 8  # Smallest number of samples in a period.
PERIOD_POINTS = 32  # Number of points in a period over which the power is averaged.
DRAWN_PIECES = 200  # Number of pieces in a picture.


@dataclass(frozen=True, eq=False, repr=False)
class Power(Shown, Tabular):
    """Period-averaged power through a contact, positive downward, without the power of the load.

    Attributes
    ----------
    contact : int
        Number of the contact.
    time : (T,) array
        Times, s.
    power : (T,) array
        Force above rest times the mean velocity of the two bodies, W.
    mean : float
        Mean power over the last `periods` periods of the drive, W.
    error : float
        Uncertainty of the mean, W: the changes of the mean, and of the force and velocity at the
        frequency of the drive, between these periods and their halves, by `harmonic.transient`,
        the change with every second sample, and the error of the trajectory.
    periods : int
        Number of periods over which the power is averaged.
    input, input_error : float
        Mean power of the drive over the same periods, and its uncertainty, W; NaN if the driven
        grains were not recorded.
    linear, linear_input : float
        Mean power through the contact and of the drive in the steady state of the linearised chain,
        which includes absorbing boundaries, W; NaN without a load.
    """

    _units: ClassVar[Mapping[str, str]] = {"time": "s", "power": "W"}

    contact: int
    time: Array
    power: Array
    mean: float
    error: float
    periods: int
    input: float
    input_error: float
    linear: float
    linear_input: float
    _begin: float

    @property
    def share(self) -> float:
        """Mean power as a fraction of the power input of the drive."""
        return self.mean / self.input

    @property
    def share_error(self) -> float:
        """Uncertainty of this fraction."""
        return (self.error + abs(self.share) * self.input_error) / abs(self.input)

    @property
    def linear_share(self) -> float:
        """Predicted fraction in linear theory."""
        return self.linear / self.linear_input

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the least and largest power over time and its mean; return the axes.

        A dashed line shows the power of linear theory.
        """
        ax = chart(ax, "time [s]", "power [W]")
        time, *envelope = np.transpose(
            [
                (self.time[piece[0]], self.power[piece].min(), self.power[piece].max())
                for piece in np.array_split(
                    np.arange(len(self.time)), min(DRAWN_PIECES, len(self.time))
                )
            ]
        )
        ax.fill_between(time, *envelope, color="0.8", lw=0, label="least to largest")
        window = [self._begin, self.time[-1]]
        ax.plot(
            window,
            [self.mean] * 2,
            color=COLOURS["vermilion"],
            label=f"mean, {prefixed(self.mean, 'W')}",
        )
        if np.isfinite(self.linear):
            ax.axhline(
                self.linear, color="k", ls="--", lw=1, label=f"linear, {prefixed(self.linear, 'W')}"
            )
        share = (
            f", {100 * self.share:.5g} % of that of the drive" if np.isfinite(self.input) else ""
        )
        title = f"Contact {self.contact}: ± {prefixed(self.error, 'W', 1)}{share}"
        return finish(ax, title)


def through(trajectory: Trajectory, contact: int, periods: int | None = None) -> Power:
    """Measure the power that passes a contact of a driven chain in its steady state.

    Parameters
    ----------
    trajectory : Trajectory
        Run with a `Drive` or `Force` of one amplitude and frequency until the motion is steady, as
        it becomes between absorbing ends (`patterns.absorbing`). The grains of the contact and the
        driven grain must be recorded with 8 or more samples per period.
    contact : int
        Number of the contact, which is below the grain of this number; 0 is the contact with the
        top wall.
    periods : int, optional
        Number of periods at the end of the run for the mean; by default half of all periods.

    Returns
    -------
    Power

    Raises
    ------
    InputError
        If nothing drives the chain at one frequency, the contact does not exist, its grains were
        not recorded, or the run has too few periods or samples.

    Examples
    --------
    >>> import lmpchain
    >>> from lmpchain import patterns
    >>> chain = lmpchain.Chain(grains=60, diameter=1e-3, gravity=0.0, top_load=1.0, bottom="wall")
    >>> endless = patterns.absorbing(chain, bottom=40, top=40)
    >>> push = lmpchain.Force(grain=60, amplitude=1e-4, frequency=0.15 / chain.time_scale)
    >>> scene = lmpchain.Scene(chain=endless, excitation=push, duration=120 / push.frequency,
    ...                        samples=1441)
    >>> passed = through(lmpchain.simulate(scene, engine="native"), 80)
    >>> f"{passed.share:.4f} of the power, {passed.linear_share:.4f} in linear theory"
    '0.4998 of the power, 0.4998 in linear theory'
    """
    scene = trajectory.scene
    drive = harmonic_drive(scene.excitation)
    period = 1 / drive.frequency
    number = int(whole_numbers(contact, "contact"))
    chain = scene.chain
    if not (0 <= number <= chain.movable and chain.contacts.exists[number]):
        raise InputError.at("contact", f"must be the number of a contact (got {contact})")
    time = trajectory.time
    count = averaged_periods(time[-1] / period, periods, 6)
    if period < SAMPLES * scene.sampling_interval * (1 - 1e-9):
        least = 1 + int(np.ceil(SAMPLES * time[-1] / period))
        raise InputError.at(
            "samples", f"must be {least} or more: {SAMPLES} per period of the drive"
        )
    known = motion_of(trajectory)
    velocity_error = known.known_error("velocity")
    _, v = motion(trajectory, np.array([number, number + 1]))
    force = contacts(trajectory, [number]).change[:, 0]
    speed = v.mean(1)
    # Force and velocity have similar relative errors.
    part = velocity_error / max(known.sampled[1], 1e-300)
    mean, error = _mean(time, force, speed, period, count, part)
    given, given_error = _input(trajectory, drive, count, part)
    linear, linear_input = _linear(chain, drive, number)
    return Power(
        contact=number,
        time=time,
        power=force * speed,
        mean=mean,
        error=error,
        periods=count,
        input=given,
        input_error=given_error,
        linear=linear,
        linear_input=linear_input,
        _begin=float(time[-1] - count * period),
    )


def _mean(
    time: Array, force: Array, speed: Array, period: float, count: int, part: float
) -> tuple[float, float]:
    """Return the mean of a power over the last periods, and its error.

    A Hann window over whole periods suppresses harmonics and transients at other frequencies.
    The relative error of force and speed is `part`.
    """
    end = time[-1]
    power = force * speed

    def mean(stride: int, begin: float, periods: int) -> float:
        # The last sample is included.
        near = slice((len(time) - 1) % stride, None, stride)
        curve: BSpline = make_interp_spline(time[near], power[near], 7)
        turn = np.arange(PERIOD_POINTS * periods) / (PERIOD_POINTS * periods)
        window = 1 - np.cos(2 * np.pi * turn)
        return float(window @ curve(begin + periods * period * turn)) / turn.size

    half = count // 2
    means = [
        mean(1, end - count * period, count),
        mean(1, end - half * period, half),
        mean(2, end - count * period, count),
        mean(1, end - 2 * half * period, half),
    ]
    window = int(count * period / (time[1] - time[0]) * (1 + 1e-9))
    signals = np.stack((force, speed), axis=1)
    signals -= signals[-window:].mean(0)
    found = amplitudes(time, signals, 2 * np.pi / period, window)
    size, left = np.abs(found[0]), transient(found)
    # A transient changes the mean by its products with the steady motion.
    unsteady = (size[0] * left[1] + size[1] * left[0] + left[0] * left[1]) / 2
    error = transient(means) + unsteady + abs(means[2] - means[0])
    return means[0], float(error) + 2 * part * float(np.abs(power).max())


def _input(
    trajectory: Trajectory, drive: Drive | Force, count: int, part: float
) -> tuple[float, float]:
    """Return the mean power of the drive, W, and its error; NaN if its grain was not recorded."""
    time = trajectory.time
    try:
        if isinstance(drive, Force):
            _, v = motion(trajectory, np.array([drive.grain]))
            force = drive.waveform.at(time)
        else:
            body = drive.body(trajectory.scene.chain)
            _, v = motion(trajectory, np.array([body]))
            # The power of inertia vanishes in the mean.
            force = force_above_rest(trajectory, body)
    except InputError:
        return np.nan, np.nan
    return _mean(time, force, v[:, 0], 1 / drive.frequency, count, part)


def _linear(chain: Chain, drive: Drive | Force, number: int) -> tuple[float, float]:
    """Return the mean powers through a contact and of the drive in the linearised chain, W."""
    if not chain.linearisable:
        return np.nan, np.nan
    omega = 2 * np.pi * drive.frequency
    u = displacements(chain, drive)
    v = 1j * omega * u
    force = dynamic_stiffness(chain, omega) * (u[:-1] - u[1:])
    passed = (force[number] * (v[number] + v[number + 1]).conj()).real / 4
    if isinstance(drive, Force):
        given = drive.amplitude * v[drive.grain].real / 2
    else:
        body = drive.body(chain)
        above, below = np.pad(force, 1)[body : body + 2]
        given = ((below - above) * v[body].conj()).real / 2
    return float(passed), float(given)
