"""Live figures of the pages: pages of `lmpchain.explore`, made when the documentation is built."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np

import lmpchain
from lmpchain import Chain, Impulse, Scene

FOLDER = Path("_static") / "live"  # in the built pages
STRIKES = np.geomspace(1e-5, 1.0, 11)

# a chain under a load of its own, and what is done to it; each with a slider for strike and load
PRESETS: dict[str, dict[str, Any]] = {
    "linear": {
        "scene": Scene(
            chain=Chain(grains=60, diameter=1e-3, gravity=0.0, top_load=0.1),
            excitation=Impulse(velocity=1e-5),
            duration=60e-6,
        ),
        "over": {
            "excitation.velocity": np.geomspace(1e-7, 1e-3, 9),
            "chain.top_load": np.geomspace(0.01, 10.0, 7),
        },
    },
    "contact_loss": {
        "scene": Scene(
            chain=Chain(grains=60, diameter=1e-3),
            excitation=Impulse(velocity=0.1),
            duration=100e-6,
        ),
        "over": {"excitation.velocity": STRIKES, "chain.gravity": np.geomspace(1.0, 1000.0, 7)},
    },
    "sonic_vacuum": {
        "scene": Scene(
            chain=Chain(grains=60, diameter=1e-3, gravity=0.0, top_load=0.0),
            excitation=Impulse(velocity=0.1),
            duration=200e-6,
        ),
        "over": {
            "excitation.velocity": np.geomspace(1e-2, 1.0, 9),
            "chain.top_load": [0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0],
        },
    },
    "driven_dimer": {
        "scene": Scene.from_dict(
            {
                "chain": {
                    "grains": 60,
                    "cell": ["steel", "aluminium"],
                    "diameter": 5e-3,
                    "gravity": 0.0,
                    "top_load": 10.0,
                },
                "excitation": {"kind": "drive", "amplitude": 1e-8, "frequency": 15e3},
                "recording": {"duration": 1e-3, "samples": 121},
            }
        ),
        "over": {
            "excitation.amplitude": np.geomspace(1e-9, 1e-6, 7),
            "chain.top_load": np.geomspace(0.3, 300.0, 7),
        },
    },
}


def frame(name: str, title: str, root: str = "") -> str:
    """Return the element of a page that shows a live figure."""
    place = f"{root}{FOLDER.as_posix()}/{name}.html"
    return f'<iframe class="live-figure" src="{place}" title="{title}" loading="lazy"></iframe>'


def write(app: Any, failure: Exception | None) -> None:
    """Put the live figures beside the built pages: the presets, and those of the gallery."""
    if failure or app.builder.format != "html":
        return
    folder = Path(app.outdir) / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for name, source in PRESETS.items():
        lmpchain.explore(source, folder / f"{name}.html")
    for page in (Path(app.srcdir) / "measurements" / "live").glob("*.html"):
        shutil.copy(page, folder)


def setup(app: Any) -> dict[str, bool]:
    """Make the figures when all pages are written."""
    app.connect("build-finished", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
