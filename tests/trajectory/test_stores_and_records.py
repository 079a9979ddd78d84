"""Stores that zarr reads while they grow, and the metadata of files."""

import dataclasses
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from helpers.example_chains import column
from helpers.example_scenes import struck

from lmpchain import InputError, Scene, Trajectory, simulate
from lmpchain.trajectory import zarr_store
from lmpchain.trajectory.gathered import numbers
from lmpchain.trajectory.record import (
    LABELS,
    Block,
    Cost,
    ErrorEstimate,
    Record,
    read_result,
    read_scene,
    shapes,
    subject,
    verdict,
)
from lmpchain.trajectory.zarr_store import Writer, check_layout, file_shapes, usable

SCENE = struck(column(1000), 1e-3, 4e-6, 500, grains=list(range(1, 1001)))
ROWS = 208  # Samples of a thousand grains that fill a chunk of about 100 KB, in multiples of 16.
RNG = np.random.default_rng(5)
U, V = RNG.normal(size=(2, 1, 500, 1000))
NAME = "trajectory.zarr"


def block(first: int, last: int, columns: slice = slice(None)) -> Block:
    return Block(slice(first, last), U[:, first:last, columns], V[:, first:last, columns], columns)


def stored(folder: Path) -> Any:
    return zarr.open_group(folder / NAME, mode="r")


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    zarr_store.create_zarr(tmp_path, SCENE, {"title": "none", "solver": 3})
    return tmp_path


def test_an_empty_store(empty: Path):
    group = stored(empty)
    assert dict(group.attrs) == {"title": "none", "solver": 3}
    assert set(group) == {"time", "grain", "displacement", "velocity"}
    for name, array in group.arrays():
        assert dict(array.attrs) == LABELS[name]
        both = ("time", "grain")
        assert array.metadata.dimension_names == ((name,) if name in both else both)
        if name != "grain":
            assert np.isnan(array[:]).all()
    assert np.array_equal(group["grain"][:], SCENE.recorded)
    assert group["grain"].dtype == np.int64
    assert group["velocity"].shards == (ROWS, 1000)


def test_samples_are_visible_when_their_shard_is_complete(empty: Path):
    writer = Writer(empty, SCENE)
    writer.put(block(0, 100))
    assert np.isnan(stored(empty)["time"][:]).all()
    writer.put(block(100, 450))  # Two shards end within this block.
    for until in (2 * ROWS, 450):
        group = stored(empty)
        assert np.array_equal(group["time"][:until], SCENE.time[:until])
        assert np.isnan(group["time"][until:]).all()
        for name, field in (("displacement", U), ("velocity", V)):
            assert np.array_equal(group[name][:until], field[0, :until])
            assert np.isnan(group[name][until:]).all()
        writer.flush()
    writer.note(ErrorEstimate(1e-3, 2e-3))
    assert stored(empty).attrs["error_so_far"] == {"samples": 450, "model": 1e-3, "solver": 2e-3}
    writer.note(ErrorEstimate(1e-3, math.inf))  # This estimate is not finite and is ignored.
    assert stored(empty).attrs["error_so_far"]["solver"] == 2e-3
    writer.put(block(450, 500))
    writer.flush()
    assert np.array_equal(stored(empty)["time"][:], SCENE.time)
    assert np.array_equal(stored(empty)["velocity"][:], V[0])


def test_omitted_grains_are_at_rest(empty: Path):
    writer = Writer(empty, SCENE)
    writer.put(block(0, 10, slice(3, 8)))
    writer.flush()
    velocity = stored(empty)["velocity"][:10]
    assert np.array_equal(velocity[:, 3:8], V[0, :10, 3:8])
    assert not velocity[:, :3].any()
    assert not velocity[:, 8:].any()


@pytest.mark.parametrize("again", [ROWS, ROWS + 30, ROWS + 90])
def test_a_run_continues_within_a_shard(empty: Path, again: int):
    """Stored samples stay until they are replaced, so that no reader sees them vanish."""
    writer = Writer(empty, SCENE)
    writer.put(block(0, ROWS + 90))
    writer.flush()
    assert usable(empty, SCENE, again)
    other = Writer(empty, SCENE, again)
    other.put(Block(slice(again, again + 20), -U[:, again : again + 20], -V[:, again : again + 20]))
    other.flush()
    sign = np.ones((ROWS + 90 + 20, 1))
    sign[again : again + 20] = -1
    last = max(again + 20, ROWS + 90)
    assert np.array_equal(stored(empty)["velocity"][:last], (sign * V[0, : len(sign)])[:last])
    times = stored(empty)["time"][:]
    assert np.array_equal(np.flatnonzero(np.isfinite(times)), np.arange(last))


def test_usable_samples(empty: Path):
    writer = Writer(empty, SCENE)
    writer.put(block(0, ROWS + 10))
    writer.flush()
    for count in (0, 1, ROWS, ROWS + 10, ROWS + 11, 500, 501, -1):
        assert usable(empty, SCENE, count) == (0 <= count <= ROWS + 10), count
    for odd in (True, 3.0, "3", None):
        assert not usable(empty, SCENE, odd)
    assert not usable(empty, Scene(**SCENE.given() | {"samples": 400}), ROWS)
    (empty / NAME / "velocity" / "c" / "1" / "0").write_bytes(b"none")
    assert not usable(empty, SCENE, ROWS + 10)
    assert usable(empty, SCENE, ROWS - 1)  # In the previous shard.


def test_arrays_on_the_disk_are_indexed_as_in_memory(empty: Path):
    writer = Writer(empty, SCENE)
    writer.put(block(0, 500))
    writer.flush()
    verdict_of = verdict(ErrorEstimate(0.0, 1e-9), Cost(1.0, 0.0, 0.0, 5, 5, 1000, "rkn4", 1e-9, 1))
    text = {
        "lmpchain_format": 1,
        "scene": SCENE.to_text(),
        "provenance": "{}",
        "engine": "native",
        "equation": 1,
    }
    zarr.open_group(empty / NAME, mode="r+").attrs.update(text | verdict_of)
    about, scene, arrays = zarr_store.read_zarr(empty)
    assert (scene, about["solver_error"]) == (SCENE, 1e-9)
    field = arrays["velocity"]
    truth = V[0]
    assert (field.shape, field.dtype, field.size) == (truth.shape, truth.dtype, truth.size)
    assert (field.ndim, len(field)) == (2, 500)
    odd = np.array([5, 3, 3])
    for key in (
        7,
        slice(3, 90, 7),
        (slice(None), 3),
        (..., -1),
        odd,
        (odd, slice(4)),
        (odd, odd),
        (slice(2), [1, 0]),
        (np.array([[1, 2], [3, 4]]), 0),
        truth[:, 0] > 0,
        (-1, -1),
    ):
        assert np.array_equal(field[key], truth[key])
    assert np.array_equal(np.asarray(field), truth)
    assert np.array_equal(2 * field - truth, truth)
    assert np.array_equal(np.abs(field), np.abs(truth))
    assert field.max() == truth.max()
    assert np.asarray(field, dtype=np.float32).dtype == np.float32
    with pytest.raises(InputError, match="is a result, which is not changed"):
        field -= truth
    assert np.array_equal(np.add(field, truth, out=np.zeros_like(truth)), 2 * truth)
    (empty / NAME / "velocity" / "c" / "0" / "0").unlink()
    with pytest.raises(
        InputError,
        match="was damaged and cannot be read: samples are missing; run the scene anew",
    ):
        field[3]
    assert np.array_equal(field[ROWS], truth[ROWS])


@pytest.mark.parametrize(
    ("samples", "grains", "shard", "chunk", "times"),
    [
        (41, 12, (48, 12), (48, 12), 41),
        (10**6, 10, (20_000, 10), (20_000, 10), 80_000),  # Whole shards in a chunk of times.
        (500, 1000, (208, 1000), (208, 1000), 500),
        (100, 12_500, (16, 12_500), (16, 12_500), 100),
        (100, 12_501, (16, 12_502), (16, 6251), 100),
        (10**6, 30_000, (16, 30_000), (16, 10_000), 65_536),
    ],
)
def test_the_layout_of_a_store(samples: int, grains: int, shard: Any, chunk: Any, times: int):
    """The layout equals the layout of earlier stores, which stay readable."""
    expected = {
        "time": (times,),
        "grain": (grains,),
        "displacement": shard,
        "velocity": shard,
        "chunk": chunk,
    }
    assert file_shapes(samples, grains) == expected


# --- metadata

RECORD = Record(
    SCENE, "native", 3, SCENE.time, SCENE.recorded, U[0], V[0], ErrorEstimate(1e-3, 2e-4),
    Cost(1.0, 2.0, 3.0, 4, 5, 6, "rkn4", 1e-9, 7, 8.0), {"choice": "of ours"},
)  # fmt: skip


def test_metadata_of_a_run_are_read_from_the_file():
    about = RECORD.attributes()
    assert read_result(about) == {
        "engine": "native",
        "equation": 3,
        "error_estimate": RECORD.error_estimate,
        "cost": RECORD.cost,
        "provenance": {"choice": "of ours"},
    }
    assert (about["model_error"], about["solver_error"]) == (1e-3, 2e-4)
    assert about["title"] == "Displacement and velocity of the grains of a chain"
    assert json.loads(about["cost"])["active_grains"] == 6
    assert read_scene(about) == SCENE
    with pytest.raises(ValueError, match="another version"):
        read_scene(about | {"lmpchain_format": 2})


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"model_error": -1e-9}, "error estimate"),
        ({"solver_error": math.nan}, "error estimate"),
        ({"cost": json.dumps(RECORD.cost._asdict() | {"steps": 1.5})}, "cost"),
        ({"cost": json.dumps(RECORD.cost._asdict() | {"integrator": 3})}, "cost"),
        ({"cost": json.dumps(RECORD.cost._asdict() | {"step_s": "1"})}, "cost"),
        ({"engine": 3}, "engine or equation"),
        ({"equation": "1"}, "engine or equation"),
        ({"provenance": json.dumps({"choice": 3})}, "provenance"),
    ],
)
def test_invalid_metadata_are_rejected(change: dict[str, Any], why: str):
    with pytest.raises(ValueError, match=f"its {why}"):
        read_result(RECORD.attributes() | change)
    read_result(RECORD.attributes() | {"model_error": 0.0, "solver_error": math.inf})
    read_result(RECORD.attributes() | {"cost": json.dumps(RECORD.cost._asdict() | {"step_s": 1})})


def test_metadata_are_consolidated_like_in_zarr(tmp_path: Path):
    """Zarr's own function warns, and Python's warning filters are shared by all threads."""
    zarr_store.create_zarr(tmp_path, SCENE, {"engine": "native"})
    file = tmp_path / zarr_store.NAME / "zarr.json"
    by_hand = json.loads(file.read_text())
    with pytest.warns(UserWarning, match="Consolidated metadata"):
        zarr.consolidate_metadata(tmp_path / zarr_store.NAME)
    assert by_hand == json.loads(file.read_text())


def test_records_are_equal_if_all_fields_are():
    gathered = {"peak_velocity": np.array([1.0, np.nan])}
    record = dataclasses.replace(RECORD, gathered=gathered)
    alike = dataclasses.replace(RECORD, gathered={"peak_velocity": np.array([1.0, np.nan])})
    assert record == alike
    changes: dict[str, Any] = {
        "engine": "modes", "equation": 1, "time": 2 * SCENE.time, "grains": SCENE.recorded[::-1],
        "displacement": 2 * U[0], "velocity": 2 * V[0], "error_estimate": ErrorEstimate(0.0, 2e-4),
        "provenance": {}, "cost": RECORD.cost._replace(steps=5), "scene": SCENE.replace(samples=3),
        "gathered": {"peak_velocity": np.array([2.0, np.nan])},
    }  # fmt: skip
    for name, value in changes.items():
        assert record != dataclasses.replace(record, **{name: value}), name
    assert record != dataclasses.replace(record, gathered={})
    assert record != "record"
    with pytest.raises(TypeError):
        hash(record)


def test_errors_and_times_are_sums_with_limits():
    assert RECORD.cost.total_s == 6.0
    for model, solver, total, remark in (
        (1e-3, 2e-4, 1.2e-3, ""),
        (0.0, 0.0, 0.0, "no recorded grain can move"),
        (1.5, 1.0, 2.0, "the largest possible value"),
        (0.0, 2.0, 2.0, "the largest possible value"),
        (0.0, math.inf, math.inf, ""),
    ):
        error = ErrorEstimate(model, solver)
        assert error.total == pytest.approx(total, rel=1e-15)
        assert remark in error.remark
        assert bool(error.remark) == bool(remark)


def test_shapes_of_energies_depend_on_the_file():
    chain = SCENE.chain.replace(damping={"drag": 1.0})
    scene = SCENE.replace(chain=chain, grains=[1, 3], quantities=["peak_velocity"])
    whole = shapes(scene, ["dissipated", "dissipated_error"])
    assert whole["displacement"] == whole["velocity"] == (500, 2)
    assert (whole["time"], whole["grain"], whole["peak_velocity"]) == ((500,), (2,), (2,))
    without = shapes(scene, ())
    assert whole.keys() - without.keys() == {"dissipated", "dissipated_error"}
    assert whole["dissipated"] == (500,)


def test_a_store_states_what_is_known_so_far(tmp_path: Path):
    """The cost of an unfinished run is unknown, and some engines accumulate no energies."""
    chain = SCENE.chain.replace(damping={"drag": 1.0})
    scene = SCENE.replace(chain=chain, grains=[1, 3])
    zarr_store.create_zarr(tmp_path, scene, subject(scene, "native", 1, {}))
    writer = Writer(tmp_path, scene)

    def read() -> tuple[dict[str, Any], set[str]]:
        """Return the result, and the names of the accumulated quantities."""
        about, found, arrays = zarr_store.read_zarr(tmp_path)
        assert found == scene
        assert arrays.keys() >= {"time", "grain", "displacement", "velocity"}
        return read_result(about), arrays.keys() - {"time", "grain", "displacement", "velocity"}

    for first, last in ((0, 450), (450, 500)):
        writer.put(Block(slice(first, last), U[:, first:last, :2], V[:, first:last, :2]))
        writer.flush()
        unknown = ErrorEstimate(0.0, math.inf)
        so_far = ErrorEstimate(1e-3, 1e-5 * last)
        for estimate in (unknown, so_far):
            writer.note(estimate)
            result, quantities = read()
            assert result["cost"] == Cost(0.0, 0.0, 0.0, 0, 0, 2, "unknown", 0.0, 1)
            assert result["error_estimate"] == estimate
            assert not quantities
    energies = {"dissipated": np.arange(500.0), "dissipated_error": np.array(1.0)}
    for values in ({}, energies):
        writer.conclude(RECORD.error_estimate, RECORD.cost, values)
        result, quantities = read()
        assert (result["cost"], result["error_estimate"]) == (RECORD.cost, RECORD.error_estimate)
        assert quantities == values.keys()
    shutil.rmtree(tmp_path / NAME / "dissipated")
    assert read()[1] == {"dissipated_error"}


def edit(*path: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    """Return a change of one entry of the metadata of an array."""

    def change(data: Any) -> None:
        for key in path[:-1]:
            data = data[key]
        data[path[-1]] = value

    return change


SHARD = ("codecs", 0, "configuration")


@pytest.mark.parametrize(
    ("node", "change", "why"),
    [
        ("", edit("node_type", value="array"), "was not written by lmpchain"),
        ("", edit("zarr_format", value=2), "is not in Zarr format 3"),
        ("", edit("attributes", value=[]), "is not in Zarr format 3"),
        ("grain", edit("data_type", value="float64"), "the data_type of grain differs"),
        ("time", edit("chunk_key_encoding", "name", value="v2"), "the chunk_key_encoding of time"),
        ("velocity", edit("fill_value", value=0.0), "the fill_value of velocity differs"),
        ("time", edit("must_understand", value=True), "in a way that lmpchain does not use"),
        ("time", edit("storage_transformers", value=[{}]), "in a way that lmpchain does not use"),
        ("time", edit("codecs", 0, "name", value="pickle"), "codecs that lmpchain does not use"),
        ("time", edit("codecs", 0, "must", value=1), "codecs that lmpchain does not use"),
        (
            "time",
            edit("codecs", 1, "configuration", "x", value=1),
            "options that lmpchain does not",
        ),
        ("time", edit("codecs", value=[]), "time is stored with codecs that lmpchain does not"),
        ("velocity", edit("codecs", 0, "name", value="other"), "its shards differ"),
        ("velocity", edit(*SHARD, "chunk_shape", value=[1, 1]), "its shards differ"),
        ("velocity", edit(*SHARD, "index_codecs", value=[]), "its shards differ"),
        ("velocity", edit(*SHARD, "index_location", value="start"), "its shards differ"),
    ],
)
def test_stores_of_another_layout_are_rejected(
    empty: Path, node: str, change: Callable[[dict[str, Any]], None], why: str
):
    store = empty / NAME
    check_layout(store, SCENE)
    file = store / node / "zarr.json"
    data = json.loads(file.read_text())
    change(data)
    file.write_text(json.dumps(data))
    with pytest.raises(ValueError, match=why):
        check_layout(store, SCENE)


def test_stores_with_other_content_are_rejected(empty: Path):
    store = empty / NAME
    with pytest.raises(ValueError, match="the shape of "):
        check_layout(store, SCENE.replace(samples=499))
    # The header of a compressed chunk declares the size of its numbers.
    numbers = zarr.open_group(store, mode="r+")["time"]
    assert isinstance(numbers, zarr.Array)
    numbers[:] = SCENE.time
    chunk = next((store / "time" / "c").glob("[0-9]*"))
    whole = chunk.read_bytes()
    check_layout(store, SCENE)
    chunk.write_bytes(whole[:4] + (2**31 - 8).to_bytes(4, "little") + whole[8:])
    with pytest.raises(ValueError, match="it declares more numbers than it can contain"):
        check_layout(store, SCENE)
    chunk.write_bytes(whole)
    (store / "more").mkdir()
    with pytest.raises(ValueError, match="contains further data"):
        check_layout(store, SCENE)
    (store / "more").rmdir()
    (store / "velocity" / "zarr.json").unlink()
    with pytest.raises(ValueError, match="velocity is not in Zarr format 3"):
        check_layout(store, SCENE)


def test_a_finished_store_is_complete_and_belongs_to_its_scene(tmp_path: Path):
    asked = ["peak_velocity", "arrival_time", "peak_force:2"]
    scene = struck(column(6), 1e-3, 4e-6, 5, quantities=asked)
    answer = simulate(scene, "native", folder=tmp_path / "run")
    alone = simulate(scene, "native")
    assert np.array_equal(answer.velocity, alone.velocity)
    assert answer.gathered.keys() == alone.gathered.keys()
    for name, values in alone.gathered.items():
        assert np.array_equal(answer.gathered[name], values, equal_nan=True)
    for name, place, value, fault in (
        ("time", 4, np.nan, "the run was finished, but samples are missing"),
        ("time", 3, 1e-6, "its times differ from those of its scene"),
        ("grain", 0, 2, "its grains differ from those of its scene"),
        ("velocity", (2, 1), np.nan, "samples are missing"),
    ):
        folder = shutil.copytree(tmp_path / "run", tmp_path / f"{name}{place}")
        zarr.open_group(folder / NAME, mode="r+")[name][place] = value
        with pytest.raises(InputError, match=fault):
            np.asarray(Trajectory.load(folder).velocity)
    written = numbers(scene, answer.gathered)
    arrivals = answer.gathered["arrival_time"]
    assert not np.isfinite(arrivals).all()
    assert written["arrival_time"]["values"] == [
        each if math.isfinite(each) else None for each in arrivals.tolist()
    ]
    assert written["peak_force:2"] == {
        "values": float(answer.gathered["peak_force:2"]),
        "errors": float(answer.gathered["peak_force:2_error"]),
        "unit": "N",
    }
    assert written["peak_velocity"]["unit"] == "m/s"
    assert written["peak_velocity"]["errors"] == answer.gathered["peak_velocity_error"].tolist()
    json.dumps(written, allow_nan=False)
