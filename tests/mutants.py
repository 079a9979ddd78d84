"""Mutation testing: change the code at random places and check whether the tests notice.

    python tests/mutants.py theory measure --number 20 --seed 7
    python tests/mutants.py lmpchain/theory/scattering.py:226:12 --tests tests/theory

A mutant reverses a comparison, swaps an operator, changes a number by one or by a fifth, or drops a
statement. Each mutant is tried by the default tests of its room, `tests/ROOM` and the doctests of
`lmpchain/ROOM`, which must pass without the mutant. At first the code of its function is exchanged
in a fork of a process that has collected the tests; only tests that call the function run there. A
mutant that none of them notices, as in code that is compiled or runs at import, is tried in a copy
of the project: the files that name the changed module run first, and kernels are compiled anew. The
first failure ends a run. The rate by room is printed last. A survivor may be equivalent: no result
depends on it.
"""

import argparse
import ast
import gc
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import Pipe, get_context
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any

import pytest

PROJECT = Path(__file__).parents[1]
NOT_COPIED = shutil.ignore_patterns(".git", ".venv", "*_cache", "*.egg-info", "build", "dist")
CPU_LIMIT_S = 900  # Limit on CPU time, s: a mutant may never end, but all kernels may be compiled.
WALL_LIMIT_S = 1800  # Limit for a mutant that waits without end.
OPPOSITES = {
    **{
        ast.Lt: ast.GtE,
        ast.GtE: ast.Lt,
        ast.Gt: ast.LtE,
        ast.LtE: ast.Gt,
        ast.Eq: ast.NotEq,
        ast.NotEq: ast.Eq,
    },
    **{
        ast.Is: ast.IsNot,
        ast.IsNot: ast.Is,
        ast.In: ast.NotIn,
        ast.NotIn: ast.In,
        ast.And: ast.Or,
        ast.Or: ast.And,
    },
    **{
        ast.Add: ast.Sub,
        ast.Sub: ast.Add,
        ast.Mult: ast.Div,
        ast.Div: ast.Mult,
        ast.FloorDiv: ast.Mult,
    },
    **{ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd},
}

# Keywords whose values change no result: looks of pictures, depths of warnings, checks of lengths.
WITHOUT_RESULT = re.compile(
    "strict|stacklevel|flush|lw|linewidth|elinewidth|ms|mew|markersize|capsize|alpha|zorder|"
    "fontsize|frameon"
)


@dataclass(frozen=True)
class Mutant:
    """A node of a program with its start and end (line, byte of the line), and its replacement."""

    path: str
    begin: tuple[int, int]
    end: tuple[int, int]
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.path}:{self.begin[0]}:{self.begin[1]} {self.before} -> {self.after}"

    @property
    def room(self) -> str:
        return Path(self.path).parts[1].removesuffix(".py")

    def applied(self, program: bytes) -> bytes:
        lines = program.splitlines(keepends=True)
        head = [*lines[: self.begin[0] - 1], lines[self.begin[0] - 1][: self.begin[1]]]
        tail = [lines[self.end[0] - 1][self.end[1] :], *lines[self.end[0] :]]
        return b"".join([*head, self.after.encode(), *tail])

    def write(self, project: Path) -> None:
        file = project / self.path
        file.write_bytes(self.applied(file.read_bytes()))


def mutate(node: ast.AST) -> str | None:
    """Return the source of a changed node; None if nothing can be changed."""
    match node:
        case ast.Compare(left=left, ops=[op, *ops], comparators=right) if type(op) in OPPOSITES:
            changed: ast.AST = ast.Compare(left, [OPPOSITES[type(op)](), *ops], right)
        case ast.BoolOp(op=op, values=values):
            changed = ast.BoolOp(OPPOSITES[type(op)](), values)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPPOSITES:
            changed = ast.BinOp(left, OPPOSITES[type(op)](), right)
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            changed = operand
        case ast.Constant(value=bool(value)):
            changed = ast.Constant(not value)
        case ast.Constant(value=int(value)):
            changed = ast.Constant(value + 1)
        case ast.Constant(value=float(value)):
            changed = ast.Constant(1.2 * value if value else 1.0)
        case ast.Expr(value=ast.Constant()):  # A docstring.
            return None
        case (
            ast.Expr() | ast.AugAssign() | ast.Raise() | ast.Continue() | ast.Break() | ast.Delete()
        ):
            return "pass"
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            return "pass"
        case _:
            return None
    return f"({ast.unparse(changed)})"


def walk(node: ast.AST) -> Iterator[ast.AST]:
    """Yield executed nodes, without parts of f-strings and keywords that change no result."""
    if isinstance(node, ast.keyword) and WITHOUT_RESULT.fullmatch(node.arg or ""):
        return
    yield node
    for name, value in ast.iter_fields(node):
        if name not in ("annotation", "returns", "decorator_list") and not isinstance(
            node, ast.JoinedStr
        ):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from walk(child)


def mutants_of(path: Path) -> list[Mutant]:
    """Return all mutants of a module."""
    name = str(path.relative_to(PROJECT))
    nodes = walk(ast.parse(path.read_text(encoding="utf-8")))
    return [
        Mutant(
            name,
            (n.lineno, n.col_offset),
            (n.end_lineno, n.end_col_offset),
            ast.unparse(n),
            changed,
        )
        for n in nodes
        if (changed := mutate(n)) is not None
    ]


def draw(places: list[str], number: int, seed: int) -> list[Mutant]:
    """Draw mutants of rooms (`theory`), modules, or places of a module (`FILE:LINE:COLUMN`)."""
    mutants = []
    for place in places:
        name, *position = place.split(":")
        source = PROJECT / name if name.startswith("lmpchain") else PROJECT / "lmpchain" / name
        modules = [source] if source.suffix else sorted(source.rglob("*.py"))
        candidates = [mutant for module in modules for mutant in mutants_of(module)]
        mutants += [
            m
            for m in candidates
            if [str(number) for number in m.begin[: len(position)]] == position
        ]
    return random.Random(seed).sample(mutants, min(number, len(mutants)))


def codes(code: CodeType) -> Iterator[CodeType]:
    """Yield the code of a module and of all its functions and classes."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from codes(constant)


def without_lines(code: CodeType) -> CodeType:
    """Return code without its places in the file."""
    constants = (without_lines(c) if isinstance(c, CodeType) else c for c in code.co_consts)
    return code.replace(co_consts=tuple(constants), co_linetable=b"", co_firstlineno=1)


Key = tuple[str, str, int]


def key_of(code: CodeType) -> Key:
    return code.co_filename, code.co_qualname, code.co_firstlineno


def changed_codes(mutant: Mutant) -> dict[Key, CodeType]:
    """Return the changed code of functions, classes and the module, by that before."""
    path = PROJECT / mutant.path
    program = path.read_bytes()
    before, after = (
        codes(compile(text, str(path), "exec", dont_inherit=True))
        for text in (program, mutant.applied(program))
    )
    return {
        key_of(old): new
        for old, new in zip(before, after, strict=True)
        if without_lines(old) != without_lines(new) and old.co_freevars == new.co_freevars
    }


def in_a_fork(task: Callable[[], Any], limit_s: float) -> Any:
    """Return what a task returns in a fork of this process; None if it ends without a result."""
    receiver, sender = Pipe(duplex=False)

    def work() -> None:
        os.setsid()
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in (1, 2):
            os.dup2(nowhere, stream)
        sender.send(task())

    process = get_context("fork").Process(target=work)
    process.start()
    sender.close()
    result = None
    with suppress(EOFError):
        result = receiver.recv() if receiver.poll(limit_s) else None
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.join()
    return result


class Exchange:
    """A plugin of pytest that tries mutants by exchanging the code of functions in forks."""

    def __init__(self, mutants: list[Mutant]):
        self.mutants = mutants
        self.failing = ""  # A test that fails without a mutant.
        self.noticed: dict[Mutant, str] = {}  # The test that notices a mutant.

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        calls = in_a_fork(lambda: [self.called(session, test) for test in session.items], 7200)
        if calls is None or None in calls:
            self.failing = session.items[calls.index(None)].nodeid if calls else "the process ends"
            return True
        functions: dict[Key, list[FunctionType]] = defaultdict(list)
        gc.unfreeze()  # Otherwise functions of imported modules may be missing.
        for thing in gc.get_objects():
            if isinstance(thing, FunctionType):
                functions[key_of(thing.__code__)].append(thing)
        for mutant in self.mutants:
            changed = {k: code for k, code in changed_codes(mutant).items() if k in functions}
            # The shortest tests run first.
            tests = sorted(
                (seconds, number)
                for number, (seconds, keys) in enumerate(calls)
                if keys & changed.keys()
            )

            def first_failure(changed: Any = changed, tests: Any = tests) -> str:
                for key, code in changed.items():
                    for function in functions[key]:
                        function.__code__ = code
                for _, number in tests:
                    if not passes(session, session.items[number]):
                        return session.items[number].nodeid
                return ""

            if tests:
                limit = 60 + 20 * sum(seconds for seconds, _ in tests)
                failed = in_a_fork(first_failure, limit)
                if failed != "":
                    self.noticed[mutant] = failed or "the end of the process, or no end"
        return True

    @staticmethod
    def called(session: pytest.Session, test: pytest.Item) -> tuple[float, set[Key]] | None:
        """Return how long a test takes, s, and which functions of lmpchain it calls.

        The result is None for a test that fails.
        """
        keys = set()

        def note(frame: FrameType, event: str, _: object) -> None:
            if event == "call" and "/lmpchain/" in frame.f_code.co_filename:
                keys.add(key_of(frame.f_code))

        begin = time.perf_counter()
        threading.setprofile(note)
        sys.setprofile(note)
        try:
            passed = passes(session, test)
        finally:
            sys.setprofile(None)
            threading.setprofile(None)
        return (time.perf_counter() - begin, keys) if passed else None


def passes(session: pytest.Session, test: pytest.Item) -> bool:
    """Run a test, and return whether it passes."""
    before = session.testsfailed
    session.config.hook.pytest_runtest_protocol(item=test, nextitem=None)
    return session.testsfailed == before


def exchange(mutants: list[Mutant], tests: list[str]) -> Exchange:
    """Try mutants of a room by exchanging code, in a process of their own."""
    os.chdir(PROJECT)
    sys.path.insert(0, str(PROJECT))
    plugin = Exchange(mutants)
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        pytest.main(["-q", "-p", "no:cacheprovider", *tests], plugins=[plugin])
    return plugin


def run_tests(mutant: Mutant, tests: list[str]) -> tuple[bool, str]:
    """Run tests in a copy of the project with a mutant; return success, and a failure's reason."""
    with tempfile.TemporaryDirectory(prefix="mutant-") as folder:
        copy = Path(folder, "lmpchain")
        # Times of files are copied, so that compiled code stays valid.
        shutil.copytree(PROJECT, copy, ignore=NOT_COPIED)
        mutant.write(copy)
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", *tests],
            cwd=copy,
            env=os.environ | {"PYTHONPATH": str(copy), "TMPDIR": folder},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT_S, CPU_LIMIT_S)),
        )
        output = "it does not end"
        with suppress(subprocess.TimeoutExpired):
            output = process.communicate(timeout=WALL_LIMIT_S)[0]
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    lines = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR", "E  "))]
    return process.returncode == 0, (lines or output.splitlines() or ["no output"])[-1]


def tests_of(room: str) -> list[str]:
    """Return the default tests of a room: the files of its folder, and its doctests."""
    files = sorted((PROJECT / "tests" / room).rglob("test_*.py"))
    doctests = PROJECT / "lmpchain" / room, PROJECT / "lmpchain" / f"{room}.py"
    return [str(p.relative_to(PROJECT)) for p in [*files, *filter(Path.exists, doctests)]]


def relevance(test: str, module: str) -> tuple[bool, int]:
    """Return how closely a file of tests is related to a module.

    The result is whether the file has the name of the module, and how often the file names the
    module or its contents.
    """
    if not (PROJECT / test).is_file():
        return False, 0
    program = ast.parse((PROJECT / module).read_text(encoding="utf-8"))
    definitions = ast.FunctionDef | ast.ClassDef
    names = {node.name for node in program.body if isinstance(node, definitions)}
    names.add(Path(module).stem)
    words = re.findall(r"\w+", (PROJECT / test).read_text(encoding="utf-8"))
    same_name = Path(test).stem == f"test_{Path(module).stem}"
    return same_name, sum(word in names for word in words)


def nearest_first(tests: list[str], module: str) -> list[str]:
    """Return the tests in the order of their relevance to a module."""
    return sorted(tests, key=lambda test: relevance(test, module), reverse=True)


def main() -> None:
    """Draw mutants, run the tests of their rooms, and print the surviving mutants."""
    every = sorted(
        path.name for path in (PROJECT / "lmpchain").iterdir() if path.name[0] not in "._"
    )
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "places", nargs="*", default=every, help="rooms, modules or FILE:LINE:COLUMN (default: all)"
    )
    parser.add_argument(
        "--number", type=int, default=30, help="how many mutants to draw (default: 30)"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--jobs", type=int, default=len(os.sched_getaffinity(0)), help="how many run at a time"
    )
    parser.add_argument("--tests", nargs="+", help="tests to run in place of those of the room")
    options = parser.parse_args()

    mutants = draw(options.places, options.number, options.seed)
    rooms = sorted({mutant.room for mutant in mutants})
    tests = {room: options.tests or tests_of(room) for room in rooms}
    noticed: dict[Mutant, str] = {}
    print(f"{len(mutants)} mutants, seed {options.seed}", flush=True)
    with ProcessPoolExecutor(
        options.jobs, mp_context=get_context("spawn"), max_tasks_per_child=1
    ) as processes:
        of_rooms = [[mutant for mutant in mutants if mutant.room == room] for room in rooms]
        for room, tried in zip(
            rooms, processes.map(exchange, of_rooms, tests.values()), strict=True
        ):
            if tried.failing:
                sys.exit(f"the tests of {room} fail without a mutant: {tried.failing}")
            noticed |= tried.noticed
            for mutant, test in tried.noticed.items():
                print(f"noticed  {mutant}\n         by {test}", flush=True)
    left = [mutant for mutant in mutants if mutant not in noticed]
    with ThreadPoolExecutor(options.jobs) as threads:
        ordered = [nearest_first(tests[mutant.room], mutant.path) for mutant in left]
        for mutant, (passed, line) in zip(left, threads.map(run_tests, left, ordered), strict=True):
            if not passed:
                noticed[mutant] = line
            print(
                f"SURVIVED {mutant}" if passed else f"noticed  {mutant}\n         by {line}",
                flush=True,
            )
    number, of_room = Counter(m.room for m in mutants), Counter(m.room for m in noticed)
    for room in rooms:
        print(f"{room}: {of_room[room]} of {number[room]}")
    print(f"{len(noticed)} of {len(mutants)} noticed")


if __name__ == "__main__":
    main()
