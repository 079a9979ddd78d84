"""Files of the results: shards and parts, and reading of any mixture of them."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from helpers.example_sweeps import SCENE

from lmpchain import InputError, load_sweep, sweep
from lmpchain.sweeps import store
from lmpchain.sweeps.file import is_name, read_sweep, read_text
from lmpchain.sweeps.store import (
    StoredArray,
    StoreLayout,
    make_layout,
    part_of,
    parts_of,
    whole_parts,
    write_part,
)


def laid(count: int, batch: int, **shapes: tuple[int, ...]) -> StoreLayout:
    columns = {
        name: StoredArray(tuple("ab"[: len(shape)]), shape, "m", "")
        for name, shape in shapes.items()
    }
    return StoreLayout(
        count, batch, columns | {"reason": StoredArray((), (), "1", "", store.NOT_DONE, str)}
    )


def test_a_hundred_files_contain_ten_thousand_scenes():
    made = laid(10**4, 64, velocity=(3,), peak=())
    assert made.shards * len(made.columns) <= 100
    assert made.shard % made.batch == 0
    assert made.shard == 64 * math.ceil(160 * 3 / 64)
    assert made.shards == math.ceil(10**4 / made.shard)
    firsts = [first for shard in range(made.shards) for first in made.batches(shard)]
    assert firsts == list(range(0, 10**4, 64))
    few = laid(5, 2, velocity=(3,))
    assert (few.shard, few.shards) == (6, 1)
    assert list(few.batches(0)) == [0, 2, 4]


def test_a_shard_is_no_larger_than_128_MB():
    wide = laid(10**6, 1, velocity=(2**10, 2**10))  # 8 MB per scene.
    assert wide.shard == 16
    huge = laid(10, 1, velocity=(2**14, 2**14))  # 2 GB
    assert huge.shard == 1
    assert laid(10**6, 5, velocity=(2**10, 2**10)).shard == 20


def test_the_layout_has_an_error_for_each_derived_number():
    extra = {"time": StoredArray(("sample",), (7,), "s", "")}
    made = make_layout(["velocity", "energy", "wall_force", "peak_force:3"], 9, 2, 7, 4, extra)
    shapes = {name: column.shape for name, column in made.columns.items()}
    numbers = "wall_force wall_force_error peak_force_3 peak_force_3_error model_error solver_error"
    over_time = {"time": (7,), "velocity": (7, 4), "energy": (7,), "energy_error": (7,)}
    assert shapes == over_time | dict.fromkeys([*numbers.split(), "reason"], ())
    assert list(made.columns)[-1] == "reason"
    assert math.isnan(made.columns["velocity"].fill)
    assert (made.columns["reason"].fill, made.columns["reason"].dtype) == ("not done", str)


def test_chunks_are_read_a_quarter_of_a_megabyte_at_a_time(tmp_path: Path):
    made = StoreLayout(4000, 4, laid(1, 1, velocity=(128, 64), peak=()).columns)
    store.create_results(tmp_path, made, {}, {"case": 4000})
    group = zarr.open_group(tmp_path / "results.zarr", mode="r")
    velocity = group["velocity"]
    peak = group["peak"]
    assert dict(group.attrs) == {"batch": 4, "swept": {"case": 4000}}
    assert velocity.chunks == (4, 128, 64)  # 64 kB per scene.
    assert velocity.shards == (made.shard, 128, 64)
    assert peak.chunks == (made.shard,)
    assert velocity.metadata.dimension_names == ("scene", "a", "b")
    assert dict(peak.attrs) == {"units": "m", "long_name": ""}
    assert np.isnan(velocity.fill_value)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["results.zarr", "store.json"]
    assert len(list((tmp_path / "results.zarr").iterdir())) == 4
    batch, arrays = store.check_store(tmp_path / "results.zarr")
    assert (batch, sorted(arrays)) == (4, ["peak", "reason", "velocity"])


@pytest.fixture
def split(tmp_path: Path, monkeypatch: Any) -> tuple[Path, StoreLayout, dict[str, np.ndarray]]:
    """Return two shards of six scenes: a complete one, and one with a part and some scenes."""
    monkeypatch.setattr(store, "STORE", store.STORE._replace(shard_scenes=2))
    made = laid(11, 3, velocity=(2, 4), peak=())
    assert (made.shard, made.shards) == (6, 2)
    (tmp_path / "parts").mkdir()
    store.create_results(tmp_path, made, {}, {"case": 11})
    rng = np.random.default_rng(1)
    values: dict[str, Any] = {"velocity": rng.normal(size=(11, 2, 4)), "peak": rng.normal(size=11)}
    values["reason"] = np.array([""] * 11)
    for first in (0, 3, 6):
        write_part(
            tmp_path, first, {name: array[first : first + 3] for name, array in values.items()}
        )
    lacking = {name: array[9:11].copy() for name, array in values.items()}
    lacking["reason"] = np.array(["", "not done"])
    lacking["velocity"][1] = lacking["peak"][1] = np.nan
    write_part(tmp_path, 9, lacking, whole=False)
    store.join_parts(tmp_path, made, 0)
    values["reason"] = np.array([*[""] * 10, "not done"])
    values["velocity"][10] = values["peak"][10] = np.nan
    return tmp_path, made, values


def test_parts_become_a_shard(split: Any):
    folder, _, _ = split
    names = sorted(path.name for path in (folder / "parts").iterdir())
    assert names == ["0000006.npz", "0000009.some.npz"]
    assert (store.complete(folder, 0), store.complete(folder, 1)) == (True, False)
    assert list(whole_parts(folder)) == [6]
    assert sorted(parts_of(folder)) == [6, 9]
    assert part_of(folder, 6) == whole_parts(folder)[6]
    write_part(folder, 9, {"peak": np.zeros(2)})
    assert list(whole_parts(folder)) == [6, 9], "what is whole takes the place of some"
    assert not part_of(folder, 9, whole=False).exists()
    (folder / "parts" / "12.npz").touch()
    assert list(whole_parts(folder)) == [6, 9]


NUMBERS = [[0], [5, 6], range(11), [10], [9, 2, 7], [1, 3, 5], [6, 7, 8], [], [4, 4, 0], [3, 5]]


@pytest.mark.parametrize("numbers", NUMBERS)
def test_any_scenes_are_read_from_shards_and_parts(split: Any, numbers: Any):
    folder, made, values = split
    rows = np.array(list(numbers), dtype=int)
    for name, array in values.items():
        found = store.read_column(folder, made, name, rows)
        assert np.array_equal(found.astype(array.dtype), array[rows], equal_nan=name != "reason")
    inner = np.array([1, 0]), np.array([3])
    found = store.read_column(folder, made, "velocity", rows, inner)
    expected = values["velocity"][rows][:, inner[0]][:, :, inner[1]]
    assert np.array_equal(found, expected, equal_nan=True)


def test_missing_results_are_nan(tmp_path: Path):
    made = laid(3, 1, peak=())
    store.create_results(tmp_path, made, {}, {"case": 3})
    assert np.isnan(store.read_column(tmp_path, made, "peak", np.arange(3))).all()
    assert store.read_column(tmp_path, made, "reason", np.arange(3)).tolist() == ["not done"] * 3
    # Reading leaves the store unchanged.
    assert store.open_store(tmp_path).read_only
    assert not store.open_store(tmp_path, writing=True).read_only


def test_leftovers_of_killed_processes_are_removed(split: Any):
    folder, made, _ = split
    store.join_parts(folder, made, 0)  # The same again: another process was faster.
    left = [
        folder / "parts" / ".0000006.1.partial",
        folder / "results.zarr" / "peak" / "c" / f"0.{'a' * 32}.partial",
    ]
    for path in left:
        path.touch()
    (folder / ".results.zarr.12.partial").mkdir()
    np.savez(part_of(folder, 3), peak=np.zeros(3))  # A part of an existing shard.
    store.clean(folder, made)
    assert not any(path.exists() for path in left)
    names = {path.name for path in folder.iterdir()}
    assert names == {"parts", "results.zarr", "shards", "store.json"}
    assert sorted(parts_of(folder)) == [6, 9]
    with pytest.raises(FileNotFoundError):
        store.join_parts(folder, made, 1)


def test_a_part_has_the_shape_of_its_column(tmp_path: Path):
    (tmp_path / "parts").mkdir()
    number = StoredArray((), (), "m", "")
    write_part(tmp_path, 0, {"peak": np.zeros((2, 3)), "words": np.array(["a"]), "ok": np.ones(2)})
    path = part_of(tmp_path, 0)
    assert store.read_part(path, "ok", number).tolist() == [1.0, 1.0]
    for name in ("peak", "words"):
        with pytest.raises(InputError, match="an array has another shape"):
            store.read_part(path, name, number)
    word = StoredArray((), (), "1", "", "", str)
    assert store.read_part(path, "words", word).tolist() == ["a"]
    with pytest.raises(InputError, match="another shape"):
        store.read_part(path, "ok", word)
    with pytest.raises(FileNotFoundError):
        store.read_part(path.with_name("none.npz"), "ok", number)


# --- the check before anything is opened


def plain(folder: Path, length: int, *, held: int, shape: Any = None) -> None:
    """Write an array as lmpchain does, and files with its number of bytes."""
    store.create_results(
        folder, laid(2, 1, peak=()), {"grain": (("grain",), np.arange(length), {})}, {"case": 2}
    )
    node = folder / "results.zarr" / "grain"
    about = json.loads((node / "zarr.json").read_text())
    about["shape"] = about["chunk_grid"]["configuration"]["chunk_shape"] = shape or [length]
    (node / "zarr.json").write_text(json.dumps(about))
    (node / "c" / "0").write_bytes(bytes(held))


def test_an_array_cannot_declare_more_than_its_file_can_contain(tmp_path: Path):
    """The limits are 64 MB, and a thousand times the size of the file."""
    cases = [
        (2**23, 0, True),
        (2**23 + 1, 0, False),
        (125 * 10**6, 10**6, True),
        (125 * 10**6 + 1, 10**6, False),
    ]
    for place, (length, held, sound) in enumerate(cases):
        folder = tmp_path / str(place)
        folder.mkdir()
        plain(folder, 5, held=held, shape=[length])
        if sound:
            assert store.check_store(folder / "results.zarr")[0] == 1
        else:
            with pytest.raises(ValueError, match="claims more data than its file has"):
                store.check_store(folder / "results.zarr")


def test_the_inner_chunks_of_a_shard_are_small_and_complete(tmp_path: Path):
    made = StoreLayout(
        4000, 4, laid(1, 1, velocity=(128, 32)).columns
    )  # 32 kB per scene, eight scenes per chunk.
    store.create_results(tmp_path, made, {}, {"case": 4000})
    file = tmp_path / "results.zarr" / "velocity" / "zarr.json"
    about = json.loads(file.read_text())
    inner = about["codecs"][0]["configuration"]
    assert inner["chunk_shape"] == [8, 128, 32]
    for rows, sound in ((8, True), (4, True), (16, False), (3, False), (0, False), (-4, False)):
        inner["chunk_shape"] = [rows, 128, 32]
        file.write_text(json.dumps(about))
        if sound:
            store.check_store(tmp_path / "results.zarr")
        else:
            with pytest.raises((ValueError, ZeroDivisionError)):
                store.check_store(tmp_path / "results.zarr")
    inner["chunk_shape"] = [8, 128, 16]
    file.write_text(json.dumps(about))
    with pytest.raises(ValueError, match="has chunks"):
        store.check_store(tmp_path / "results.zarr")


@pytest.mark.parametrize("batch", [0, -1, True, 1.0, "1", None])
def test_a_batch_is_a_positive_integer(tmp_path: Path, batch: Any):
    store.create_results(tmp_path, laid(2, 1, peak=()), {}, {"case": 2})
    file = tmp_path / "results.zarr" / "zarr.json"
    about = json.loads(file.read_text())
    file.write_text(json.dumps(about | {"attributes": {"batch": batch}}))
    with pytest.raises(ValueError, match="was not written by lmpchain"):
        store.check_store(tmp_path / "results.zarr")


# --- places, keys and names


GRID = {"chain.gravity": [1.0, 2.0, 3.0], "excitation.velocity": [1e-4, 2e-4]}
CUBE = {"scene": SCENE, "grid": GRID, "disorder": {"m": 2, "seed": 1, "realisations": 4}}


def test_positions_follow_the_last_axis_first():
    plan = read_sweep(CUBE)
    assert (plan.shape, plan.count) == ((3, 2, 4), 24)
    places = [plan.place(number) for number in range(24)]
    assert places == [tuple(map(int, np.unravel_index(n, plan.shape))) for n in range(24)]
    assert len({plan.key(number) for number in range(24)}) == 24
    assert {len(plan.key(number)) for number in range(24)} == {16}
    assert is_name(plan.name)
    for other in ("", "0" * 15, "0" * 17, "g" * 16, "../" + "0" * 13, None, "A" * 16):
        assert not is_name(other)


def test_a_name_and_a_key_depend_on_all_options():
    base = {"scene": SCENE, "grid": {"chain.gravity": [1.0, 2.0]}}
    other_scene = SCENE | {"excitation": {"kind": "impulse", "velocity": 2e-4}}
    names = set()
    keys = set()
    changes: list[dict[str, Any]] = [{}, {"tolerance": 1e-5}, {"engine": "chebyshev"}]
    changes += [{"keep": ["velocity"]}, {"scene": other_scene}]
    for mean in (1.0, 1.0 + 1e-7):
        law = {"mean": 62e9 * mean, "deviation": 1e9, "per_grain": True}
        modulus = {"chain.material.youngs_modulus": law}
        changes.append({"random": {"draws": 1, "seed": 1} | modulus})
    for change in changes:
        plan = read_sweep(base | change)
        names.add(plan.name)
        keys |= {plan.key(0), plan.key(1)}
        assert read_text(plan.text, plan.folder).name == plan.name
        assert read_text(plan.text, plan.folder).key(1) == plan.key(1)
    assert (len(names), len(keys)) == (7, 14)
    twice = read_sweep(base | {"keep": ["velocity", "displacement", "velocity"]})
    assert twice.name == read_sweep(base).name
    assert read_sweep(base).key(0) == read_sweep(base | {"grid": {"chain.gravity": [1.0]}}).key(0)
    plan = read_sweep(base)
    assert (plan.tolerance, plan.engine) == (1e-6, "native")
    assert plan.keep == ["displacement", "velocity"]
    with pytest.raises(InputError, match="must be tables: a stored sweep does not refer to"):
        read_text(json.dumps({"scene": "scene.toml", "files": {}}), plan.folder)


def test_one_scene_for_each_value_is_tried_before_the_run():
    plan = read_sweep(CUBE)
    tried = [(scene.chain.gravity, scene.excitation.velocity) for scene in plan.trials()]
    assert tried == [(1.0, 1e-4), (1.0, 2e-4), (2.0, 1e-4), (3.0, 1e-4)]


def test_32_draws_are_tried(monkeypatch: Any):
    """A sweep is rejected if none of the draws gives a valid scene."""
    law = {"low": -40.0, "high": 1.0}
    draws = {"draws": 400, "seed": 1, "chain.gravity": law}
    plan = read_sweep({"scene": SCENE, "keep": ["wall_force"], "random": draws})
    gravities = plan.axes[0].columns["chain.gravity"]
    first = int(np.flatnonzero(np.array(gravities) >= 0)[0])
    for sign, ok in (
        (gravities[:first] + gravities[first:], first < 32),
        ([-1.0] * 32 + [1.0] * 368, False),
    ):
        plan.axes[0].columns["chain.gravity"] = sign
        if ok:
            assert next(plan.trials()).chain.gravity == gravities[first]
        else:
            with pytest.raises(InputError, match="gravity"):
                list(plan.trials())
    plan.axes[0].columns["chain.gravity"] = [-1.0] * 31 + [1.0] * 369
    assert next(plan.trials()).chain.gravity == 1.0


@pytest.mark.parametrize("grains", [0, -1, True, 2.0, "6", None, 10**8 + 1])
def test_drawn_numbers_need_a_chain_with_this_number_of_grains(grains: Any):
    keys = SCENE["chain"] | {"grains": grains}
    chain = {key: value for key, value in keys.items() if value is not None}
    law = {"seed": 1, "realisations": 2, "chain.masses": {"low": 1e-6, "high": 2e-6}}
    plan = read_sweep({"scene": SCENE | {"chain": chain}, "disorder": law})
    with pytest.raises(InputError, match=r"chain\.grains: must be a whole number from 1"):
        plan.grains((0,))


def test_a_sweep_of_several_shards(tmp_path: Path, monkeypatch: Any):
    from lmpchain.sweeps import tasks

    monkeypatch.setattr(tasks, "TASKS", tasks.TASKS._replace(scenes=2))
    asked = {"scene": SCENE, "grid": {"chain.gravity": np.arange(1.0, 8.0)}}
    whole = sweep(asked, tmp_path / "one").load()
    monkeypatch.setattr(store, "STORE", store.STORE._replace(shard_scenes=1))
    found = sweep(asked, tmp_path / "many")
    assert found.identical(whole)
    assert len(list((tmp_path / "many").glob("*/results.zarr/reason/c/*"))) == 2
    assert not list((tmp_path / "many").glob("*/parts/*"))
    assert load_sweep(tmp_path / "many").velocity[5].equals(whole.velocity[5])
