"""A cached property without the lock of Python 3.11."""

from __future__ import annotations

import functools
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or sys.version_info >= (3, 12):
    from functools import cached_property as cached_property
else:

    class cached_property(functools.cached_property):
        """Like `functools.cached_property` of Python 3.12.

        The lock of Python 3.11 is shared by all objects. A process that is forked while another
        thread holds the lock waits for it for ever. Two threads may compute a value twice.
        """

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            if instance is None:
                return self
            # Python calls this method only if the instance has no value yet.
            values = instance.__dict__
            values[self.attrname] = self.func(instance)
            return values[self.attrname]
