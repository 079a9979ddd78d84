"""Make two measured traces: one for `lmpchain new --example hammer`, and one in this folder.

What they show is known in closed form; `tests/scene/test_trace_files.py` compares with it.
"""

from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
EXAMPLE = HERE.parents[1] / "templates" / "examples" / "hammer.csv"


def hammer() -> str:
    """Return an oscilloscope trace: a hammer at 0, volts, points between columns, noise before.

    As Tektronix writes it, with what was set beside the first rows: 0.05 V of offset, and a
    half-sine of 1.5 V in 40 us.
    """
    facts = [
        "Record Length,5.000000e+02",
        "Sample Interval,4.000000e-07",
        "Trigger Point,1.000000000000e+02",
        ",",
        "Source,CH1",
        "Vertical Units,V",
        "Vertical Scale,5.000000e-01",
        "Horizontal Units,s",
        "Probe Atten,1.000000e+01",
        "Model Number,TDS2014B",
    ]
    # Noise with zero mean, so that the mean before the trigger is the offset.
    half = np.random.default_rng(43).normal(0, 2e-3, 50).round(5)
    noise = np.concatenate([half, -half])
    rows = []
    for n in range(500):
        time = (n - 100) * 4e-7
        push = 1.5 * np.sin(np.pi * time / 40e-6) if 0 <= time <= 40e-6 else 0.0
        volts = 0.05 + (noise[n] if n < 100 else 0.0) + push
        fact = facts[n] if n < len(facts) else ","
        rows.append(f"{fact},,{time:.12f},{volts:.9f},")
    return "\n".join(rows) + "\n"


def vibrometer() -> str:
    """Return a vibrometer trace: a piston from 1 ms on, volts, decimal commas, milliseconds."""
    lines = ["Messung;12", "Empfindlichkeit;5 \u00b5m/V", "", "Zeit (ms);Kanal A (mV)"]
    for n in range(301):
        time = n * 0.01
        path = 40.0 * max(0.0, time - 1.0) ** 2
        lines.append(f"{time:.2f};{250 + path:.7f}".replace(".", ","))
    return "\r\n".join(lines) + "\r\n"


if __name__ == "__main__":
    EXAMPLE.write_text(hammer(), encoding="utf-8")
    (HERE / "vibrometer.csv").write_bytes(b"\xef\xbb\xbf" + vibrometer().encode())
