"""Properties that are computed once."""

import ast
import multiprocessing
import threading
from pathlib import Path

import lmpchain
from lmpchain.util.lazy import cached_property


class Slow:
    def __init__(self) -> None:
        self.begun = threading.Event()
        self.may_end = threading.Event()
        self.times = 0

    @cached_property
    def value(self) -> int:
        self.times += 1
        self.begun.set()
        self.may_end.wait()
        return 7


def test_a_fork_reads_a_property_that_another_thread_computes():
    """The lock of Python 3.11 would never be released in the child."""
    slow, other = Slow(), Slow()
    other.may_end.set()
    thread = threading.Thread(target=lambda: slow.value)
    thread.start()
    slow.begun.wait()
    child = multiprocessing.get_context("fork").Process(target=lambda: other.value)
    child.start()
    child.join(60)
    hung = child.is_alive()
    child.kill()
    slow.may_end.set()
    thread.join()
    assert not hung
    assert (slow.value, slow.times) == (7, 1)


def test_no_module_uses_the_property_with_a_lock():
    package = Path(lmpchain.__file__).parent
    for path in package.rglob("*.py"):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if "cached_property" in text else ():
            if isinstance(node, ast.ImportFrom) and node.module == "functools":
                names = {alias.name for alias in node.names}
                assert "cached_property" not in names or path.name == "lazy.py", path
