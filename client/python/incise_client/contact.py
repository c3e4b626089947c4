"""Tissue near the blade, rendered at the device's own rate."""

from __future__ import annotations

import math
from typing import Any, Optional

import numpy as np

RESERVE_J = 5e-4
LEAK_W = 0.01
_SMOOTHING_S = 0.005  # of the velocity
_LONGEST_STEP_S = 0.005  # after a pause of the caller a force grows as in this time at most
_LONGEST_NS = 1_000_000_000  # a plane is valid at most so long, whatever it says


class ContactRenderer:
    """Renders the planes that the server sends (Force.contact, PROTOCOL.md section 7), however old they are.

    No force is NaN, exceeds the limits, or starts without the ramp; when its plane expires it fades at the slew limit.
    Delay cannot make it unstable: what spring and friction give back is bounded by an account of the work that the tool has
    done on them here. In t seconds no more than RESERVE_J + LEAK_W * t comes out than went in, except for the work of one step
    and of the fade. One thread at a time. For a device's loop of 1 kHz and more use the same class of the C++ library::

        renderer = incise_client.ContactRenderer()
        client.on_force = lambda _, force: renderer.take(force, time.monotonic_ns())
        newtons = renderer.force(tool_position, time.monotonic_ns())
    """

    def __init__(self, most_n: float = 3.3, slew_n_s: float = 500.0, ramp_s: float = 2.0,
                 stiffest_n_m: float = 2000.0) -> None:
        self._most, self._slew, self._ramp_s, self._stiffest = most_n, slew_n_s, ramp_s, stiffest_n_m
        self._until_ns = 0
        self._over = True  # the server said that there is no tissue; otherwise the plane has expired
        self._point = self._normal = np.zeros(3)
        self._stiffness = self._damping = self._resistance = self._friction = 0.0
        self._penetrated = False
        self._last_ns: Optional[int] = None
        self._tool = self._velocity = self._applied = self._slewed = np.zeros(3)
        self._account, self._ramp = RESERVE_J, 0.0

    def take(self, force: Any, now_ns: int) -> None:
        """Takes over a wire.Force that arrived at now_ns, by a clock of this machine."""
        self._until_ns, self._over = now_ns, True  # without a contact there is no tissue
        contact = force.Contact()
        if contact is None:
            return
        point, normal = (np.array([v.X(), v.Y(), v.Z()]) for v in (contact.Point(), contact.Normal()))
        numbers = (contact.StiffnessNPerM(), contact.DampingNSPerM(), contact.CuttingResistanceN(),
                   contact.FrictionNSPerM())
        size = float(np.linalg.norm(normal))
        sound = bool(np.isfinite(point).all()) and 0.5 < size < 2 and all(math.isfinite(n) and n >= 0 for n in numbers)
        if not sound or contact.ValidForNs() <= 0:
            return
        self._point, self._normal = point, normal / size
        self._stiffness, self._damping, self._resistance, self._friction = numbers
        self._stiffness = min(self._stiffness, self._stiffest)
        self._penetrated = bool(contact.Penetrated())
        self._over = False
        self._until_ns = now_ns + min(contact.ValidForNs(), _LONGEST_NS)

    def force(self, tool_m: Any, now_ns: int) -> Any:
        """The force on the hand, N, world frame, for the tool's origin at tool_m now. Apply it until the next call."""
        tool = np.asarray(tool_m, dtype=float)
        usable = bool(np.isfinite(tool).all())
        dt = 0.0 if self._last_ns is None else max(0.0, (now_ns - self._last_ns) * 1e-9)
        if dt > 0 and usable:
            step = tool - self._tool
            self._account += LEAK_W * dt - float(self._applied @ step)
            self._velocity = self._velocity + dt / (_SMOOTHING_S + dt) * (step / dt - self._velocity)
        if usable:
            self._tool, self._last_ns = tool, now_ns
        valid = usable and now_ns < self._until_ns
        elastic, viscous, energy = self._plane(tool) if valid else (np.zeros(3), np.zeros(3), 0.0)
        self._account = min(self._account, energy + RESERVE_J)
        held = max(self._account, 0.0)
        wanted = (held / energy if energy > held else 1.0) * elastic + min(1.0, held / RESERVE_J) * viscous
        return self._limit(wanted, min(dt, _LONGEST_STEP_S), valid, energy > 0 or self._penetrated)

    def _plane(self, tool: Any) -> tuple[Any, Any, float]:
        """A spring that gives way at its resistance, a damper that does not pull, friction."""
        normal = self._normal
        depth = float(normal @ (self._point - tool))
        if 0 < self._resistance < self._stiffness * depth:
            holds = self._resistance / self._stiffness
            self._point = self._point + (holds - depth) * normal
            depth = holds
        away = float(normal @ self._velocity)
        spring = self._stiffness * max(depth, 0.0)
        viscous = np.zeros(3)
        if depth > 0:
            viscous = max(-self._damping * away, -spring) * normal
        if self._penetrated:
            viscous = viscous - self._friction * self._velocity
        elif depth > 0:
            viscous = viscous - self._friction * (self._velocity - away * normal)
        return spring * normal, viscous, 0.5 * spring * max(depth, 0.0)

    def _limit(self, wanted: Any, growing_s: float, valid: bool, touching: bool) -> Any:
        """The limits in the server's order: finite, clamp, slew, ramp."""
        size = float(np.linalg.norm(wanted))
        if not math.isfinite(size):
            wanted, size = np.zeros(3), 0.0
        if size > self._most:
            wanted = self._most / size * wanted
        change = wanted - self._slewed
        most = max(0.0, self._slew - self._most / self._ramp_s) * growing_s
        size = float(np.linalg.norm(change))
        self._slewed = self._slewed + most / size * change if size > most else wanted
        if valid and (self._ramp > 0 or touching):
            self._ramp = min(1.0, self._ramp + growing_s / self._ramp_s)
        self._applied = self._ramp * self._slewed
        if not valid and not self._over and not self._slewed.any():
            self._ramp = 0.0  # it expired while it acted, so the next one starts from nothing
        return self._applied
