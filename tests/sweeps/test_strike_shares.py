"""Shares of strikes in solitary waves, for every exponent in one call."""

import numpy as np
import pytest

from lmpchain import InputError, RunFailed, strike_shares
from lmpchain.sweeps import strike_shares as strikes


def test_shares_agree_with_independent_runs() -> None:
    """Shares agree with runs by SciPy's DOP853, whose durations were chosen by hand."""
    found = strike_shares([1.5, 2.0, 3.0], accuracy=1e-6)
    expected = [0.99366100753, 0.99845213883, 0.99989110533]
    assert found.share == pytest.approx(expected, abs=2e-10)
    assert (found.share_error < 1e-6).all()
    assert found.velocity[0] == pytest.approx(0.68163155, rel=1e-7)
    axes = found.plot()
    assert axes.get_xlabel() == "exponent of the contact force"
    assert list(found.to_dataframe()["waves"]) == [1, 1, 1]


def test_errors_cover_longer_chains() -> None:
    """A share with a loose accuracy, from a short chain, is right within its error."""
    exponents = [1.08, 1.25, 2.4]
    loose = strike_shares(exponents, accuracy=1e-4)
    tight = strike_shares(exponents, accuracy=3e-6)
    assert (tight.grains >= loose.grains).all()
    assert tight.grains[0] > loose.grains[0]
    off = np.abs(loose.share - tight.share)
    assert (off <= loose.share_error + tight.share_error).all()
    assert (np.diff(tight.share) > 0).all()


def test_wrong_exponents_are_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Waves of a linear chain are not solitary; for similar exponents they separate too late."""
    with pytest.raises(InputError, match="above 1"):
        strike_shares([1.0])
    with pytest.raises(InputError, match="above 1"):
        strike_shares([])
    for accuracy in (0.0, 1.0, np.nan, "small"):
        with pytest.raises(InputError, match=r"^accuracy: must be between 0 and 1 \(got"):
            strike_shares([1.5], accuracy=accuracy)  # type: ignore[arg-type]
    monkeypatch.setattr(strikes, "LONGEST_CHAIN", 100)
    with pytest.raises(RunFailed, match=r"exponent 1\.01"):
        strike_shares([1.01])
