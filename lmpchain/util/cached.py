"""What is computed of a record once, at the first use."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from functools import cached_property as cached_property
else:

    class cached_property(functools.cached_property):
        """The one of functools, for half of the time: without the lock that it takes before Python 3.12."""

        def __get__(self, instance, owner=None):
            """Return the value, which from then on is found without asking here."""
            if instance is None:
                return self
            value = instance.__dict__[self.attrname] = self.func(instance)
            return value
