"""Results as tables: units in the header, all digits, and files that the trace reader accepts."""

import ast
from pathlib import Path

import numpy as np
import pandas
import pytest

from lmpchain import Chain, Damping, Force, Impulse, InputError, Scene, plan, simulate
from lmpchain.design import Traces
from lmpchain.measure import contact, energy, fit, front, spectrum, traces
from lmpchain.theory import bands, dimer_soliton, scattering
from lmpchain.util.tabular import Tabular

CHAIN = Chain(
    grains=12,
    diameter=5e-3,
    gravity=0.0,
    top_load=2.0,
    top="wall",
    bottom="wall",
    damping=Damping(viscoelastic=1e-8),
)
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=0.1), duration=8e-5, samples=161)


@pytest.fixture(scope="module")
def damped():
    return simulate(SCENE, engine="native")


def columns(result: Tabular) -> list[str]:
    return list(result.to_dataframe().columns)


def test_a_trajectory_is_a_table_with_all_digits(damped, tmp_path: Path):
    damped.to_csv(tmp_path / "run.csv")
    frame = damped.to_dataframe()
    assert frame.shape == (161, 25)
    assert columns(damped)[:3] == ["time [s]", "displacement_1 [m]", "displacement_2 [m]"]
    np.testing.assert_array_equal(frame["velocity_7 [m/s]"], damped.velocity[:, 6])
    again = pandas.read_csv(tmp_path / "run.csv", float_precision="round_trip")
    pandas.testing.assert_frame_equal(again, frame, check_exact=True)
    assert [path.name for path in tmp_path.iterdir()] == ["run.csv"]


def test_written_tables_are_read_unchanged(damped, tmp_path: Path):
    path = tmp_path / "trace.csv"
    table = traces.gather(damped, force=[5, "wall"], velocity=[3, 5], above_rest=True)
    table.to_csv(path)
    measured = Traces.from_csv(path, [5], field="force")
    np.testing.assert_array_equal(measured.time, damped.time)
    np.testing.assert_array_equal(measured.values[:, 0], contact.sensor(damped, 5).change)
    speeds = Traces.from_csv(path, [3, 5])
    np.testing.assert_array_equal(speeds.values, damped.velocity[:, [2, 4]])
    wall = Force(grain=1, file=path, columns=["time", "change_force_wall"])
    np.testing.assert_array_equal(wall.times, damped.time)
    np.testing.assert_array_equal(wall.force, contact.contacts(damped, [12]).change[:, 0])
    # The reader of traces also reads this file.
    speeds.to_csv(path)
    np.testing.assert_array_equal(Traces.from_csv(path, [3, 5]).values, speeds.values)
    contact.contacts(damped, [4]).to_csv(path)
    change = Traces.from_csv(path, [4], field="contact").values[:, 0]
    np.testing.assert_array_equal(change, contact.contacts(damped, [4]).change[:, 0])


@pytest.mark.parametrize("named", [{}, {"columns": ["time", "change_force_4"]}])
def test_a_force_on_a_grain_is_not_read_as_a_contact_force(damped, tmp_path: Path, named):
    """A fit must not compare the force on a grain with a contact force."""
    path = tmp_path / "trace.csv"
    traces.gather(damped, force=[4], above_rest=True).to_csv(path)
    with pytest.raises(InputError, match="change_force_4 is the force of a grain"):
        Traces.from_csv(path, [4], field="contact", **named)
    with pytest.raises(InputError, match="not change_force_5"):
        Traces.from_csv(path, [5], field="force", **named)
    contact.contacts(damped, [4]).to_csv(path)
    with pytest.raises(
        InputError, match="of a contact, including its value at rest, not change_contact_4"
    ):
        Traces.from_csv(path, [4], field="contact", columns=["time", "force_contact_4"])
    # The force of a wall equals the force of its contact.
    traces.gather(damped, force=["wall"], above_rest=True).to_csv(path)
    change = Traces.from_csv(path, [12], field="contact", columns=["time", "change_force_wall"])
    np.testing.assert_array_equal(change.values, contact.contacts(damped, [12]).change)


def test_traces_agree_with_the_measurements(damped):
    frame = traces.gather(
        damped, force=[5, "wall", "top"], displacement=[1], energy=True
    ).to_dataframe()
    np.testing.assert_array_equal(frame["force_5 [N]"], contact.sensor(damped, 5).force)
    np.testing.assert_array_equal(frame["force_wall [N]"], contact.wall_force(damped))
    np.testing.assert_array_equal(frame["force_top [N]"], contact.wall_force(damped, "top"))
    np.testing.assert_array_equal(frame["displacement_1 [m]"], damped.displacement[:, 0])
    ledger = energy.ledger(damped)
    np.testing.assert_array_equal(frame["energy_dissipated [J]"], ledger.dissipated)
    np.testing.assert_array_equal(frame["energy_total [J]"], ledger.total)


def test_missing_places(damped):
    with pytest.raises(InputError, match="velocity: grain 13 was not recorded"):
        traces.gather(damped, velocity=[13])
    with pytest.raises(InputError, match="force: grain 0 does not exist"):
        traces.gather(damped, force=[0])
    with pytest.raises(InputError, match="force: must be grains or wall, top, bottom"):
        traces.gather(damped, force=["side"])  # type: ignore[list-item]
    with pytest.raises(InputError, match="choose at least one force"):
        traces.gather(damped)


def test_every_result_is_a_table(damped, tmp_path: Path):
    wave = np.linspace(0.1, 3.0, 7)
    cell = bands.Cell([1.0, 3.0], [1.0, 1.0])
    results = {
        "time [s],force_3 [N],change_force_3 [N]": contact.sensor(damped, 3),
        "time [s],overlap_contact_2 [m]": contact.contacts(damped, [2]),
        "time [s],kinetic [J]": energy.ledger(damped),
        "time [s],of_contact_0 [J]": energy.losses(damped),
        "time [s],kinetic_1 [J]": energy.shares(damped),
        "grain,depth [m],time [s],amplitude [m/s]": front.track(damped),
        "frequency [Hz],amplitude_1 [m/s/Hz]": spectrum.spectrum(damped),
        "frequency [Hz],amplitude_-": spectrum.dispersion(damped, 1, 12),
        "frequency [rad/s],energy [J]": fit.fit_modes(damped),
        "wavenumber,frequency_1 [rad/s],frequency_2 [rad/s]": bands.branches(cell, wave),
        "frequency [rad/s],wavenumber,amplitude_reflected_real": scattering.transmission(
            CHAIN.replace(top="free", bottom="fixed", damping=None), [1e4, 2e4]
        ),
        "place,values": dimer_soliton.solve(0.3428),
        "engine": plan(SCENE),
    }
    for header, result in results.items():
        result.to_csv(tmp_path / "table.csv")
        text = (tmp_path / "table.csv").read_text()
        assert text.startswith(header), text[:100]
        assert len(text.splitlines()) == len(result.to_dataframe()) + 1


def test_results_with_a_picture_are_tables():
    """Every class with a picture is a table, except scenes, chains and functions of place."""
    others = {"ChainPicture", "Scene", "Soliton", "ExponentFit"}
    drawn = set()
    for file in (Path(__file__).parents[2] / "lmpchain").rglob("*.py"):
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and node.name not in others:
                methods = [item.name for item in node.body if isinstance(item, ast.FunctionDef)]
                bases = [ast.unparse(base) for base in node.bases]
                if "plot" in methods and "Tabular" not in bases:
                    drawn.add(node.name)
    assert drawn == set()


def test_an_unwritable_file_is_preserved(damped, tmp_path: Path):
    with pytest.raises(InputError, match="is a folder"):
        damped.to_csv(tmp_path)
    assert not list(tmp_path.iterdir())
