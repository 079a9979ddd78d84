"""Memory of this process: free memory, and a limit for a short computation."""

from __future__ import annotations

import os
import re
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def memory_limit(size: int) -> Iterator[None]:
    """Limit the further memory of this process to `size` bytes; beyond it, raise `MemoryError`.

    The limit exists only on Linux; on other systems the function has no effect.
    """
    taken = _address_space()
    if taken is None:
        yield
        return
    before, most = resource.getrlimit(resource.RLIMIT_AS)
    limits = [limit for limit in (before, most, taken + size) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (before, most))


def free_memory() -> float:
    """Return the memory that this process can still allocate, bytes; infinite if unknown.

    The smallest of three limits counts: the free memory of the machine, the limit of the control
    group (for example of a container or a batch job), and the limit that `ulimit -v` sets.
    """
    limits = [_available(), *_control_group()]
    taken = _address_space()
    most = resource.getrlimit(resource.RLIMIT_AS)[0]
    if taken is not None and most != resource.RLIM_INFINITY:
        limits.append(most - taken)
    return max(min(limits), 0.0)


def machine_memory() -> dict[str, int]:
    """Return the memory of the machine by the names of `/proc/meminfo`, bytes."""
    sizes = re.findall(r"(\w+): +(\d+) kB", Path("/proc/meminfo").read_text())
    return {name: 1024 * int(kilobytes) for name, kilobytes in sizes}


def _address_space() -> int | None:
    """Return the size of the address space of this process, bytes; None if unknown."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


def _available() -> float:
    """Return the free memory of the machine, bytes; infinite if unknown."""
    try:
        return machine_memory()["MemAvailable"]
    except (OSError, KeyError):
        return float("inf")


def _control_group() -> Iterator[float]:
    """Yield the remaining memory of this process's control group, if it has a limit."""
    group = Path("/sys/fs/cgroup")
    for limit, usage in (
        ("memory.max", "memory.current"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"),
    ):
        try:
            yield float((group / limit).read_text()) - float((group / usage).read_text())
        except (OSError, ValueError):
            continue
