"""Tissue near the blade, rendered at the device's own rate."""

from __future__ import annotations

import math
from typing import Any, Optional

import numpy as np

RESERVE_J = 5e-4
LEAK_W = 0.01
SILENCE_NS = 50_000_000
_SMOOTHING_S = 0.005  # of the velocity
_LONGEST_STEP_S = 0.005  # after a pause of the caller a force grows as in this time at most
_LONGEST_NS = 1_000_000_000  # a plane is valid at most so long, whatever it says
_FARTHEST_M = 1e4


class ContactRenderer:
    """Renders the planes that the server sends (Force.contact, PROTOCOL.md section 7), however old they are.

    No force is NaN, exceeds the limits, or starts without the ramp; when its plane expires it fades at the slew limit.
    Delay cannot make it unstable: what spring and friction give back is bounded by an account of the work that the tool has
    done on them here. In t seconds no more than RESERVE_J + LEAK_W * t comes out than went in, except for the work of one step
    and of the fade. After SILENCE_NS without a call (a thread that was paused) the next call gives no force, and the ramp begins
    again. The same arithmetic as client/contact_renderer.cpp. One thread at a time. For a device's loop of 1 kHz and more use
    the same class of the C++ library::

        renderer = incise_client.ContactRenderer()
        client.on_force = lambda _, force: renderer.take(force, time.monotonic_ns())
        newtons = renderer.force(tool_position, time.monotonic_ns())

    Limits: magnitude in N, change in N/s (above most_n / ramp_s, the part that the ramp takes), the ramp in s (0: none), the stiffest
    plane in N/m, and the largest torque in N m, whose change is limited in the same proportion. Raises ValueError for one that is not
    a finite number from 0.
    """

    def __init__(self, most_n: float = 3.3, slew_n_s: float = 500.0, ramp_s: float = 2.0,
                 stiffest_n_m: float = 2000.0, most_torque_n_m: float = 0.2) -> None:
        for name, value in (("most_n", most_n), ("ramp_s", ramp_s), ("stiffest_n_m", stiffest_n_m),
                            ("most_torque_n_m", most_torque_n_m)):
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"ContactRenderer: {name} is {value:g}; accepted are finite numbers from 0")
        self._slew_beside_ramp = slew_n_s - (most_n / ramp_s if ramp_s > 0 else 0.0)
        if not (math.isfinite(slew_n_s) and self._slew_beside_ramp > 0):
            raise ValueError(f"ContactRenderer: slew_n_s is {slew_n_s:g}; accepted are finite numbers above most_n / ramp_s")
        self._most, self._ramp_s, self._stiffest = most_n, ramp_s, stiffest_n_m
        self._most_torque, self._torque_slew = most_torque_n_m, slew_n_s * most_torque_n_m / most_n if most_n > 0 else 0.0
        self._until_ns = 0
        self._over = True  # the server said that there is no tissue; otherwise the plane has expired
        self._point = self._normal = self._arm = np.zeros(3)
        self._stiffness = self._damping = self._resistance = self._friction = 0.0
        self._penetrated = False
        self._last_ns: Optional[int] = None  # of the last call
        self._tool_ns: Optional[int] = None  # of the last one with a place that is a number
        self._tool = self._velocity = self._applied = self._slewed = self._torque = np.zeros(3)
        self._orientation: Any = None
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
        arm = np.zeros(3) if contact.Arm() is None else np.array([contact.Arm().X(), contact.Arm().Y(), contact.Arm().Z()])
        sound = (bool(np.isfinite(point).all() and np.isfinite(arm).all()) and 0.5 < size < 2
                 and all(math.isfinite(n) and n >= 0 for n in numbers))
        if not sound or contact.ValidForNs() <= 0:
            return
        self._point, self._normal, self._arm = point, normal / size, arm
        self._stiffness, self._damping, self._resistance, self._friction = numbers
        self._stiffness = min(self._stiffness, self._stiffest)
        self._penetrated = bool(contact.Penetrated())
        self._over = False
        self._until_ns = now_ns + min(contact.ValidForNs(), _LONGEST_NS)

    def force(self, tool_m: Any, now_ns: int) -> Any:
        """The force on the hand, (3,) float64, N, world frame, for the tool's origin at tool_m, (3,), now.

        Apply it until the next call. With a tool that is not finite, or more than 10 km away, it fades. now_ns is of take()'s clock and
        must rise. Raises ValueError for another shape.
        """
        tool = np.asarray(tool_m, dtype=float)
        if tool.shape != (3,):
            raise ValueError(f"tool_m has shape {tool.shape}; accepted is (3,)")
        usable = bool(np.isfinite(tool).all()) and float(np.linalg.norm(tool)) <= _FARTHEST_M
        dt = 0.0 if self._tool_ns is None else max(0.0, (now_ns - self._tool_ns) * 1e-9)
        if dt > 0 and usable:
            step = tool - self._tool
            self._account += LEAK_W * dt - float(self._applied @ step)
            self._velocity = self._velocity + dt / (_SMOOTHING_S + dt) * (step / dt - self._velocity)
        growing_s = self._growing_s(now_ns)
        if self._last_ns is not None and now_ns - self._last_ns > SILENCE_NS:
            # Nobody knows what the device has done meanwhile: it held the force, or its watchdog has let go of it.
            self._applied = self._slewed = self._torque = self._velocity = np.zeros(3)
            self._ramp = 0.0
        self._last_ns = now_ns
        if usable:
            self._tool, self._tool_ns = tool.copy(), now_ns
        valid = usable and now_ns < self._until_ns
        elastic, viscous, energy = self._plane(tool) if valid else (np.zeros(3), np.zeros(3), 0.0)
        self._account = min(self._account, energy + RESERVE_J)
        held = max(self._account, 0.0)
        wanted = (held / energy if energy > held else 1.0) * elastic + min(1.0, held / RESERVE_J) * viscous
        return self._limit(wanted, growing_s, valid, energy > 0 or self._penetrated)

    def wrench(self, tool_m: Any, orientation: Any, now_ns: int) -> tuple[Any, Any]:
        """The same for a device that makes torques: the force, and the torque about the tool's origin, N m, both (3,) float64, world frame.

        The force acts where the tissue presses on the blade, and turning the tool is work that is booked, too. orientation, (4,), is the unit
        quaternion w x y z of world_from_tool; one that is not finite or far from unit is passed over. Use one of the two throughout. Raises
        ValueError for other shapes.
        """
        quaternion = np.asarray(orientation, dtype=float)
        if quaternion.shape != (4,):
            raise ValueError(f"orientation has shape {quaternion.shape}; accepted is (4,)")
        if 0.25 < float(quaternion @ quaternion) < 4:
            if self._orientation is not None:
                self._account -= float(self._torque @ _turn(self._orientation, quaternion))
            self._orientation = quaternion.copy()
        growing_s = self._growing_s(now_ns)  # before force() takes the time
        force = self.force(tool_m, now_ns)
        wanted = np.cross(self._arm, force)
        size = float(np.linalg.norm(wanted))
        if not math.isfinite(size):
            wanted, size = np.zeros(3), 0.0
        if size > self._most_torque:
            wanted = self._most_torque / size * wanted
        # The force is ramped, so its moment is; an arm that jumps is not.
        self._torque = _toward(self._torque, wanted, self._torque_slew * growing_s)
        return force, self._torque.copy()

    def _growing_s(self, now_ns: int) -> float:
        """What a force may grow by at this call, as time: 0 at the first one, and at the first after a silence."""
        passed_ns = 0 if self._last_ns is None else max(0, now_ns - self._last_ns)
        return 0.0 if passed_ns > SILENCE_NS else min(passed_ns * 1e-9, _LONGEST_STEP_S)

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
        self._slewed = _toward(self._slewed, wanted, self._slew_beside_ramp * growing_s)
        if valid and (self._ramp > 0 or touching):
            self._ramp = min(1.0, self._ramp + growing_s / self._ramp_s) if self._ramp_s > 0 else 1.0
        self._applied = self._ramp * self._slewed
        if not valid and not self._over and not self._slewed.any():
            self._ramp = 0.0  # it expired while it acted, so the next one starts from nothing
        return self._applied.copy()


def _toward(a: Any, b: Any, most: float) -> Any:
    """From a to b, by so much at most."""
    size = float(np.linalg.norm(b - a))
    return a + most / size * (b - a) if size > most else b


def _turn(a: Any, b: Any) -> Any:
    """The rotation from a to b, quaternions w x y z, as its axis times its angle, by the shorter way."""
    w = float(a @ b)
    v = a[0] * b[1:] - b[0] * a[1:] - np.cross(b[1:], a[1:])
    sine = float(np.linalg.norm(v))
    return (-2.0 if w < 0 else 2.0) * math.atan2(sine, abs(w)) / sine * v if sine > 0 else np.zeros(3)
