"""Every measured constant is printed by a script in analysis/calibration/ that anyone can rerun."""

import importlib
import math
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "analysis" / "calibration"
SHARED = ("common", "scenes")
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py") if path.stem not in SHARED)
# The slowest scripts.
LONG = (
    "adaptive_steps",
    "amplified_rounding",
    "halved_steps",
    "linear_model_error",
    "opening_error_factor",
    "reference_cost",
    "richardson_estimate",
    "roundoff",
)
# Constants that a quick run with few scenes confirms.
SHOWN = {
    "adaptive_steps": ["OPENING_STEPS.crossing", "OPENING_STEPS.least_crossing"],
    "amplified_rounding": ["GROWTH.digit", "GROWTH.changes", "GROWTH.reach", "GROWTH.rate"],
    "between_samples": ["RESOLVED", "RESOLVED_BY_DIFFERENCES", "SHAPE.safety"],
    "chaos_test": ["PATIENCE.attempts", "PATIENCE.stalled"],
    "error_constants": ["rkn4.error_constant", "kahan-li8.error_constant", "dop853.error_constant"],
    "fit_thresholds": ["SOLITARY (height)", "SOLITARY (speed, width)", "WEAK_STRIKE"],
    "halved_steps": ["SAFETY (orbits)"],
    "linear_model_error": [
        "LINEAR[package][0]",
        "LINEAR[velocity][0]",
        "LINEAR[peak][0]",
        "LOOKS.evenly",
        "STEEPEST",
        "FACTORS.doubt",
        "FACTORS.large",
    ],
    "long_steps": ["INTERPOLATION.error", "ROUNDING.interpolated"],
    "linear_openings": ["FEW (waves)"],
    "opening_error_factor": ["FIRST_STEP.foreseen", "FIRST_STEP.longest", "FIRST_STEP.safe_strain"],
    "predictability": [
        *("MEASURED.opening", "MEASURED.flying", "MEASURED.fewest"),
        "reflection_time: 0.907470, 0.681632",
    ],
    "richardson_estimate": [
        *("TRUST.safety", "TRUST.least_gain", "TRUST.settled", "OPENINGS.near"),
        *("OPENINGS.equal_order", "FEWEST_STEPS", "MANY_STEPS"),
    ],
    "roundoff": [
        *("native_floor", "ROUNDING.phase", "ROUNDING.drift", "ROUNDING.plain", "STRONG"),
        *("HEIGHTS.rounding", "HEIGHTS.headroom", "modes.round_off", "chebyshev.round_off"),
    ],
    "stability_limits": ["TRUSTED", "FIRST_STEP.safe_strain (limit)", "limit: verlet"],
    "transfer_matrices": ["WARM_UP"],
    "step_refinement": ["STEP_CONTROL.target", "STEP_CONTROL.least", "STEP_CONTROL.most"],
}


def claimed(script: str) -> list[str]:
    """Return the constants that the README lists for a script."""
    rows = re.findall(
        rf"^\| (.+?) \| .* \| {script} \|",
        (FOLDER / "README.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    return [row.strip("`") for row in rows]


@pytest.mark.parametrize(
    "script",
    [
        pytest.param(name, marks=pytest.mark.soak if name in LONG else pytest.mark.slow)
        for name in SCRIPTS
    ],
)
def test_each_script_prints_the_constants_of_the_readme(script, monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    module = importlib.import_module(script)
    rows = {row.name: row for row in module.main(quick=True)}
    assert claimed(script)
    assert set(claimed(script)) <= set(rows)
    assert all(math.isfinite(row.shipped) for row in rows.values())
    assert [name for name in SHOWN.get(script, []) if not rows[name].holds] == []


def test_every_script_states_its_purpose_and_usage():
    for script in SCRIPTS:
        text = (FOLDER / f"{script}.py").read_text(encoding="utf-8")
        assert text.startswith('"""Measure ')
        assert f"python analysis/calibration/{script}.py --quick" in text


def test_scripts_named_in_comments_exist():
    named = {
        script
        for path in (ROOT / "lmpchain").rglob("*.py")
        for script in re.findall(
            r"analysis/calibration/(\w+)\.py", path.read_text(encoding="utf-8")
        )
    }
    assert named
    assert named <= set(SCRIPTS)
