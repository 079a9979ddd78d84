"""All excitations by name."""

from __future__ import annotations

from .acting import Drive as Drive
from .acting import Force as Force
from .base import Excitation
from .initial import Displacement as Displacement
from .initial import Impulse as Impulse
from .initial import Packet as Packet
from .initial import Profile as Profile
from .initial import Riemann as Riemann

EXCITATIONS: dict[str, type[Excitation]] = {
    e.kind: e for e in (Impulse, Displacement, Profile, Packet, Riemann, Drive, Force)
}
