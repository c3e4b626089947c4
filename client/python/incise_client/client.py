"""A connection to an incised over TCP."""

from __future__ import annotations

import socket
import ssl as tls
import struct
import time
from dataclasses import dataclass
from typing import Any, Callable, Iterable, Optional, Sequence

import flatbuffers
import numpy as np

from incise.wire import (BladeEdge, BladeLoad, BladeModel, Body, Box, Bye, Delta, Error, FieldOn, FieldValues, Force, Hello, Message, Ping, Pong,
                         PoseBatch, PoseReport, Positions, PositionsReport, Recording, Reset, Resync, Role, SnapshotBegin, SnapshotChunk, SnapshotEnd,
                         StrokeAction, StrokeControl, SurfaceDelta, Undo, Vec3, View, Welcome)

from .carry import carry, carry_tets
from .errors import ConnectError, RequestError
from .part import Surface, VolumePart
from .replica import ApplyError, Replica

MAX_MESSAGE_BYTES = 64 << 20
MAX_POSES_PER_BATCH = 8192
MAX_COORDINATE_M = 1_000_000
CLOSED = "this client is closed: connect() makes another one"

# The schema's struct PoseSample, byte for byte.
POSE_DTYPE = np.dtype([("source_ns", "<i8"), ("position", "<f8", 3), ("orientation", "<f8", 4), ("buttons", "<u4"),
                       ("reserved", "<u4")])


@dataclass
class Pose:
    """Where the tool is: world_from_tool. Nanoseconds of the source's clock, metres, unit quaternion w x y z."""

    source_ns: int
    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    buttons: int = 0


def _enum_value(enum: Any, what: str, given: int | str) -> int:
    """The value of a wire enum, given as that or by its name in small letters."""
    values = {name.rstrip("_").lower(): value for name, value in vars(enum).items() if not name.startswith("_")}
    if given in values.values():
        return int(given)
    if isinstance(given, str) and given in values:
        return values[given]
    raise ValueError(f"{what}: found {given!r}; accepted is " + ", ".join(f'"{name}"' for name in values) + f", or a wire.{enum.__name__}")


_MODULES = {
    Body.Body.Welcome: Welcome.Welcome, Body.Body.Ping: Ping.Ping, Body.Body.Error: Error.Error, Body.Body.Bye: Bye.Bye,
    Body.Body.PoseReport: PoseReport.PoseReport, Body.Body.Delta: Delta.Delta,
    Body.Body.SnapshotBegin: SnapshotBegin.SnapshotBegin, Body.Body.SnapshotChunk: SnapshotChunk.SnapshotChunk,
    Body.Body.SnapshotEnd: SnapshotEnd.SnapshotEnd, Body.Body.Force: Force.Force,
    Body.Body.SurfaceDelta: SurfaceDelta.SurfaceDelta, Body.Body.PositionsReport: PositionsReport.PositionsReport,
    Body.Body.BladeLoad: BladeLoad.BladeLoad, Body.Body.FieldValues: FieldValues.FieldValues,
}


class Client:
    """Holds a replica in step. One thread at a time: everything happens within poll() and what calls it.

    ``role`` is "viewer", "operator", "simulator" or "admin", ``view`` "volume", "surface" or "none"; wire.Role and wire.View are taken, too.
    ``replica`` is a Replica for view Volume, a Surface for view Surface; each snapshot, as after an undo, brings another object. With ``box``, two corners ((x, y, z), (x, y, z)) in
    metres, it is what touches that box: a Surface, or for view Volume a VolumePart. ``blade`` is an operator's own: heel and
    tip in the tool's frame, metres. ``fields`` names those to hold ("*": all), with view Volume and no box. ``resume`` is a client that was connected to the same server: its state is continued.

    Callbacks are attributes, None until you set them; set right after connect() they miss nothing. All are called within poll() and the waits, on the thread that calls these, with
    the client first; they may send and close, but neither poll nor wait. What they raise comes out of poll(), after the message was dealt with.

    - ``on_delta(client, delta)``: the replica has taken a step, a wire.Delta (view Surface: wire.SurfaceDelta). It is at the new revision.
    - ``on_field(client, name)``: somebody has set the field of that name; ``vertex_fields`` or ``tet_fields`` has it.
    - ``on_force(client, force)``: role Operator: a wire.Force, for ContactRenderer.take.
    - ``on_positions_report(client, report)``: role Simulator: what became of positions, a wire.PositionsReport.
    - ``on_blade_load(client, load)``: role Simulator, with ``load_rate_hz``: what a blade does to the body, a wire.BladeLoad.
    - ``on_error(client, error)``: the server refused one message, or has news such as NotRecorded: a wire.Error, with ``Code()`` (a
      wire.ErrorCode), ``Text()`` (bytes) and ``InReplyTo()``, the number of the refused message or 0. ``error`` keeps the last one.

    Errors: ConnectError where the server cannot be reached, refuses the client or has ended the connection, or after close(), from the
    constructor, poll(), the waits and the send functions. RequestError from a wait for a message that the server refused. ValueError, before anything
    is sent, for numbers or shapes that no server takes.
    """

    def __init__(self, host: str, port: int, *, role: int | str = "viewer", view: int | str = "volume",
                 token: str = "", source_name: str = "blade", take_over: bool = False,
                 blade: Optional[tuple[Sequence[float], Sequence[float]]] = None, max_rate_hz: float = 0.0,
                 box: Optional[tuple[tuple[float, float, float], tuple[float, float, float]]] = None,
                 timeout_s: float = 5.0, resume: Optional["Client"] = None,
                 ssl_context: Optional[tls.SSLContext] = None, load_rate_hz: float = 0.0,
                 fields: Sequence[str] | str = ()) -> None:
        role, view = _enum_value(Role.Role, "role", role), _enum_value(View.View, "view", view)
        if isinstance(fields, str):
            fields = [fields]
        held = resume if resume and not resume._awaiting_snapshot else None
        # The fields that were asked for, by name, as they are at the replica's revision: a row for each id, float32 or int32.
        self.vertex_fields: dict[str, Any] = held.vertex_fields if held else {}
        self.tet_fields: dict[str, Any] = held.tet_fields if held else {}
        self._values: dict[int, list[Any]] = {}  # of fields, in the snapshot that is on its way
        self.replica: Any = held.replica if held else Replica()
        self.welcome: Any = None
        self.report: Any = None  # the last wire.PoseReport: what became of an operator's poses
        self.recording: int = Recording.Recording.Off  # whether the server records poses, by the last message that says so
        self.error: Any = None  # the last wire.Error that was not fatal
        self.on_error: Optional[Callable[["Client", Any], None]] = None
        self._refused: dict[int, RequestError] = {}  # by the number of the message; the newest ones
        self.resyncs = 0
        self.snapshots = 0
        self.on_delta: Optional[Callable[["Client", Any], None]] = None
        self.positions_report: Any = None  # the last wire.PositionsReport: what became of a simulator's positions
        self.on_positions_report: Optional[Callable[["Client", Any], None]] = None
        self.on_blade_load: Optional[Callable[["Client", Any], None]] = None
        self.on_field: Optional[Callable[["Client", str], None]] = None
        self.on_force: Optional[Callable[["Client", Any], None]] = None
        self._sequence = 0
        self._frame = 0
        self._frame_sequence = 0  # of the message with the positions of _frame
        self._input = bytearray()
        self._closed = False
        self._snapshot: Optional[tuple[Any, list[Any]]] = None
        self._awaiting_snapshot = False
        self._holds_state = False  # of the session that Welcome names
        self._state_hash = held._state_hash if held else 0  # of the whole mesh at the replica's revision, as announced
        try:
            self._socket: Any = socket.create_connection((host, port), timeout_s)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if ssl_context:
                self._socket = ssl_context.wrap_socket(self._socket, server_hostname=host)
        except OSError as error:
            raise ConnectError(f"{host}:{port}: {error}") from error
        session = held.welcome.Session() if held else 0
        end = time.monotonic() + timeout_s
        try:
            self._send_hello(role, view, token, source_name, take_over, blade, max_rate_hz, box, session, load_rate_hz, fields)
            while self.welcome is None:
                if time.monotonic() > end:
                    raise ConnectError("no Welcome in time")
                if not self._handle_next():
                    self._receive(0.1)
        except ConnectError as error:
            self._closed = True
            self._socket.close()
            raise ConnectError(f"{host}:{port}: {error}", error.code) from error

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def close(self) -> None:
        """Says goodbye and closes. A second time does nothing; what is held can still be read. All else raises ConnectError from here on."""
        if self._closed:
            return
        try:
            self._send(Body.Body.Bye, lambda b: _table(b, Bye, [("Reason", 1)]))
        except ConnectError:
            pass
        self._closed = True
        self._socket.close()

    def _demand_open(self) -> None:
        if self._closed:
            raise ConnectError(CLOSED)

    # ---- Receiving ----

    def poll(self, timeout_s: float = 0.0) -> int:
        """Handles what has arrived, waiting at most ``timeout_s`` for the first byte. Returns the number of messages."""
        self._demand_open()
        handled = int(self._handle_next())  # one that came with Welcome
        if not self._closed:  # by a callback
            self._receive(0.0 if handled else timeout_s)
        while not self._closed and self._handle_next():
            handled += 1
        return handled

    def _receive(self, timeout_s: float) -> None:
        try:
            self._socket.settimeout(max(timeout_s, 1e-6))
            data = self._socket.recv(1 << 20)
        except (TimeoutError, tls.SSLWantReadError):
            return
        except OSError as error:
            raise ConnectError(f"the connection has ended: {error}") from error
        if not data:
            raise ConnectError("the server has closed the connection")
        self._input += data

    def _handle_next(self) -> bool:
        """Handles the next message, if it is there whole."""
        if len(self._input) < 4:
            return False
        (size,) = struct.unpack_from("<I", self._input)
        if self._input.startswith(b"HTTP"):
            raise ConnectError("the port speaks HTTP, not the binary protocol: use the other port (listen.tcp_port, 7450 by default)")
        if not 16 <= size <= MAX_MESSAGE_BYTES:
            raise ConnectError(f"a message of {size} bytes; accepted are 16 to {MAX_MESSAGE_BYTES}")
        if len(self._input) < 4 + size:
            return False
        body = bytes(self._input[4:4 + size])
        del self._input[:4 + size]
        self._handle(body)
        return True

    def wait_for_revision(self, revision: int, timeout_s: float = 10.0) -> bool:
        """Polls until the replica holds a state of this session, at the revision or beyond. False if the time is over first."""
        return self._wait(lambda: self.snapshots_or_resumed and self.replica.revision >= revision, timeout_s)

    def wait_for_report(self, sequence: int, timeout_s: float = 10.0) -> bool:
        """Polls until the server has dealt with all poses up to the message of that number. Raises RequestError if it refused it."""
        return self._wait(lambda: self.report is not None and self.report.ThroughSequence() >= sequence, timeout_s, sequence)

    def wait_for_positions_report(self, frame: int, timeout_s: float = 10.0) -> bool:
        """Polls until the server has dealt with the positions of that frame, or of a later one. Raises RequestError if it refused them."""
        return self._wait(lambda: self.positions_report is not None and self.positions_report.Frame() >= frame, timeout_s,
                          self._frame_sequence if frame == self._frame else 0)

    @property
    def snapshots_or_resumed(self) -> bool:
        """Whether the replica holds a state of this session. A reset and an undo begin another one: then it does when the snapshot is here."""
        return self._holds_state

    def _wait(self, done: Callable[[], bool], timeout_s: float, sequence: int = 0) -> bool:
        self._demand_open()
        end = time.monotonic() + timeout_s
        while not done():
            if sequence in self._refused:
                raise self._refused.pop(sequence)
            left = end - time.monotonic()
            if left <= 0:
                return False
            self.poll(min(left, 0.1))
        return True

    def _handle(self, data: bytes) -> None:
        if data[4:8] != b"INC1":
            raise ConnectError("the server sent something that is not a message of this protocol")
        message = Message.Message.GetRootAs(data, 0)
        table = _MODULES.get(message.BodyType())
        if table is None:
            return  # not for us
        body = table()
        body.Init(message.Body().Bytes, message.Body().Pos)
        kind = message.BodyType()
        if kind == Body.Body.Welcome:
            self.welcome = body
            self.recording = body.Recording()
            self._holds_state = body.Resumed()
            if not body.Resumed():
                self.replica = Replica()
                self._snapshot = None
                self._awaiting_snapshot = True
        elif kind == Body.Body.Ping:
            pairs = [("Nonce", body.Nonce()), ("PingSentNs", body.SentNs()), ("ReceivedNs", time.monotonic_ns())]
            self._send(Body.Body.Pong, lambda b: _table(b, Pong, pairs))
        elif kind == Body.Body.Error:
            if body.Fatal():
                raise ConnectError(_text(body.Text()), body.Code())
            self.error = body
            if body.InReplyTo():
                self._refused[body.InReplyTo()] = RequestError(_text(body.Text()), body.Code(), body.InReplyTo())
                if len(self._refused) > 100:
                    del self._refused[next(iter(self._refused))]
            if self.on_error:
                self.on_error(self, body)
        elif kind == Body.Body.Bye:
            raise ConnectError(_text(body.Text()) or "the server said goodbye")
        elif kind == Body.Body.PoseReport:
            self.report = body
            self.recording = body.Recording()
        elif kind == Body.Body.PositionsReport:
            self.positions_report = body
            if self.on_positions_report:
                self.on_positions_report(self, body)
        elif kind == Body.Body.BladeLoad:
            if self.on_blade_load:
                self.on_blade_load(self, body)
        elif kind == Body.Body.Force:
            if self.on_force:
                self.on_force(self, body)
        elif kind in (Body.Body.Delta, Body.Body.SurfaceDelta) and not self._awaiting_snapshot:
            if self._try_change(lambda: self._apply(body)):
                self._state_hash = body.StateHash()
                if self.on_delta:
                    self.on_delta(self, body)
        elif kind == Body.Body.SnapshotBegin:
            self._snapshot = (body, [])
            self._values = {}
        elif kind == Body.Body.SnapshotChunk and self._snapshot:
            self._snapshot[1].append(body)
        elif kind == Body.Body.FieldValues and (self._snapshot or not self._awaiting_snapshot):
            self._values.setdefault(body.Field(), []).append(body)
            if not self._snapshot and body.Last() and self._try_change(lambda: self._renew_field(body)) and self.on_field:
                self.on_field(self, _text(self.welcome.Fields(body.Field()).Name()))
        elif kind == Body.Body.SnapshotEnd and self._snapshot:
            self._try_change(lambda: self._end_snapshot(body))

    def _end_snapshot(self, end: Any) -> None:
        begin, chunks = self._snapshot or (None, [])
        self._snapshot = None
        if begin and begin.View() == View.View.Surface:
            self.replica = Surface.from_snapshot(begin, chunks, end)
        elif begin and begin.Box():
            self.replica = VolumePart.from_snapshot(begin, chunks, end)
        else:
            self.replica = Replica.from_snapshot(begin, chunks, end)
        self._take_fields(begin)
        self.snapshots += 1
        self._state_hash = end.StateHash()
        self._awaiting_snapshot = False
        self._holds_state = True

    def _take_fields(self, begin: Any) -> None:
        self.vertex_fields, self.tet_fields = {}, {}
        for k in range(begin.FieldsLength() if begin else 0):
            self._take_field(begin.Fields(k))

    def _take_field(self, place: int) -> None:
        """Makes a field of the values that have come."""
        facts = self.welcome.Fields(place)
        parts = [part.I32AsNumpy() if facts.Whole() else part.F32AsNumpy() for part in self._values.pop(place, [])]
        flat = np.concatenate(parts)
        rows = flat.reshape(-1, facts.Components()) if facts.Components() > 1 else flat
        on_vertices = facts.On() == FieldOn.FieldOn.Vertices
        name = _text(facts.Name())
        if len(rows) < len(self.replica.positions if on_vertices else self.replica.tets):
            raise ApplyError(f"the field {name} came with {len(rows)} rows")
        (self.vertex_fields if on_vertices else self.tet_fields)[name] = rows.copy()

    def _renew_field(self, last: Any) -> None:
        if last.Revision() != self.replica.revision:
            raise ApplyError(f"a field at revision {last.Revision()}, at {self.replica.revision}")
        self._take_field(last.Field())

    def _apply(self, delta: Any) -> None:
        self.replica.apply(delta)
        if isinstance(self.replica, Replica):
            self.vertex_fields = {name: carry(delta, values) for name, values in self.vertex_fields.items()}
            self.tet_fields = {name: carry_tets(delta, values) for name, values in self.tet_fields.items()}

    def _try_change(self, change: Callable[[], None]) -> bool:
        """Makes a change. If the replica refuses it, asks for a snapshot and returns False."""
        try:
            change()
            return True
        except (ApplyError, ValueError):
            self.resyncs += 1
            self._awaiting_snapshot = True
            self._send(Body.Body.Resync, lambda b: _table(b, Resync, [("Revision", self.replica.revision)]))
            return False

    # ---- Sending ----

    def send_poses(self, poses: Iterable[Pose]) -> int:
        """Sends poses in time order. Returns the sequence for wait_for_report(). Raises ValueError for a pose with NaN or infinity;
        the server passes over others that it cannot use, and ``report`` counts them.
        """
        rows = [(p.source_ns, p.position, p.orientation, p.buttons, 0) for p in poses]
        return self.send_pose_array(np.array(rows, POSE_DTYPE))

    def send_pose_array(self, poses: Any) -> int:
        """The same from an array of ``incise_client.POSE_DTYPE``: source_ns, position, orientation (w x y z), buttons, reserved (0)."""
        self._demand_open()
        poses = np.asarray(poses, POSE_DTYPE)
        finite = np.isfinite(poses["position"]).all(axis=-1) & np.isfinite(poses["orientation"]).all(axis=-1)
        if not finite.all():
            k = int(np.argmin(finite))
            raise ValueError(f"poses: number {k} has position {poses['position'][k]} and orientation {poses['orientation'][k]}; "
                             "accepted are finite numbers")
        for first in range(0, len(poses), MAX_POSES_PER_BATCH):
            part = np.ascontiguousarray(poses[first:first + MAX_POSES_PER_BATCH], POSE_DTYPE)

            def build(b: Any, raw: bytes = part.tobytes(), n: int = len(part)) -> int:
                b.StartVector(POSE_DTYPE.itemsize, n, 8)
                b.head -= len(raw)
                b.Bytes[b.head:b.head + len(raw)] = raw
                return _table(b, PoseBatch, [("Poses", b.EndVector())])

            self._send(Body.Body.PoseBatch, build, part.nbytes)
        return self._sequence

    def send_positions(self, positions: Any, *, ids: Any = None, first: int = 0, revision: Optional[int] = None) -> int:
        """For role Simulator: where vertices are now, (n, 3), metres, as float32 or float64. The vertices are ``ids`` ((n,), ascending),
        or ``first``, ``first + 1``, ... ``revision`` is that of the state they were computed with, by default the replica's.
        Returns the frame's number for wait_for_positions_report(); ``positions_report`` lists the vertices held back. Raises ValueError
        for another shape, masked numbers, coordinates that are not finite or beyond 1,000 km, ids that are no whole numbers of 32 bits or do
        not ascend (sort them, and the rows with them), or, where the whole body is held, vertices that it does not have;
        without ``revision`` also while no state is held: after connect(), and after a reset or an undo, wait_for_revision(0) waits for it.
        """
        if np.ma.is_masked(positions):
            raise ValueError("positions: found an array with masked numbers; accepted are arrays in which all numbers count")
        array = np.ascontiguousarray(positions)
        if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "fiu":
            raise ValueError(f"positions: found shape {array.shape} of {array.dtype}; accepted is (n, 3) of real numbers")
        single = array.dtype == np.float32
        flat = array.astype("<f4" if single else "<f8", copy=False).reshape(-1)
        if not (np.abs(flat) <= MAX_COORDINATE_M).all():
            k = int(np.argmin(np.abs(flat) <= MAX_COORDINATE_M)) // 3
            raise ValueError(f"positions: row {k} is {array[k]}; accepted are finite numbers of at most {MAX_COORDINATE_M:,} m")
        if ids is not None:
            ids = np.asarray(ids)
            if ids.shape != (len(array),) or ids.dtype.kind not in "iu" or (ids.size and (ids.min() < 0 or ids.max() >= 2**32)):
                raise ValueError(f"ids: found shape {ids.shape} of {ids.dtype}; accepted is ({len(array)},) of whole numbers of 32 bits")
            back = np.flatnonzero(ids[1:] <= ids[:-1])
            if len(back):
                k = int(back[0]) + 1
                raise ValueError(f"ids: number {k} is {ids[k]} after {ids[k - 1]}; accepted are ascending ids, each once")
        last = int(ids[-1]) if ids is not None and len(ids) else first + len(array) - 1
        # As many as the body has, where all of it is held; an older revision has no more.
        count = len(self.replica.positions) if isinstance(self.replica, Replica) and self.snapshots_or_resumed else 0
        if len(array) and last >= count > 0:
            raise ValueError(f"{'first' if ids is None else 'ids'}: vertex {last}; accepted are those below {count}, which the body has")
        if first < 0 or last >= 2**32:
            raise ValueError(f"first: vertices {first} to {last}; accepted are whole numbers of 32 bits")
        if revision is None and not self.snapshots_or_resumed:
            raise ValueError("positions: no state of the body has come yet, as just after a connection, a reset or an undo; "
                             "wait_for_revision(0) waits for it")
        self._frame += 1

        def build(b: Any) -> int:
            fields = [("F32" if single else "F64", b.CreateNumpyVector(flat))]
            if ids is not None:
                fields.append(("Ids", b.CreateNumpyVector(np.ascontiguousarray(ids, "<u4"))))
            return _table(b, Positions, fields + [
                ("Frame", self._frame), ("Revision", self.replica.revision if revision is None else revision),
                ("SourceNs", time.monotonic_ns()), ("First", first)])

        self._send(Body.Body.Positions, build, flat.nbytes + (0 if ids is None else 4 * len(ids)))
        self._frame_sequence = self._sequence
        return self._frame

    def send_model(self, load: Any, point: Sequence[float], normal: Sequence[float], stiffness: Any, *, damping: float = 0.0,
                   resistance: float = 0.0, valid_s: float = 0.05) -> int:
        """For role Simulator: its own model of the tissue at a blade, in answer to the wire.BladeLoad ``load``. From ``point``, a place
        of the tool's origin, inwards the force is stiffness (point - tool): (3, 3), N/m, symmetric, positive semidefinite. ``normal`` is
        unit, out of the tissue; ``damping`` N s/m along it; at ``resistance`` N the tissue gives way (0: it holds). It is rendered for
        ``valid_s`` seconds from the load on. A bad one comes back as ``error``. Returns the message's sequence.
        """
        matrix3 = np.ascontiguousarray(stiffness, "<f8")
        if matrix3.shape != (3, 3):
            raise ValueError(f"stiffness: found shape {matrix3.shape}; accepted is (3, 3)")
        if not np.isfinite([*point, *normal, *matrix3.flat, damping, resistance, valid_s]).all():
            raise ValueError(f"point, normal, stiffness, damping, resistance, valid_s: found {point}, {normal}, {matrix3.tolist()}, "
                             f"{damping}, {resistance}, {valid_s}; accepted are finite numbers")
        if len(point) != 3 or len(normal) != 3:
            raise ValueError(f"point, normal: found {point}, {normal}; accepted are three numbers each")
        if not 0 < valid_s <= 1:
            raise ValueError(f"valid_s: found {valid_s}; accepted is above 0 and up to 1")
        flat = matrix3.reshape(-1)

        def build(b: Any) -> int:
            matrix = b.CreateNumpyVector(flat)
            BladeModel.Start(b)
            BladeModel.AddSource(b, load.Source())
            BladeModel.AddServerNs(b, load.ServerNs())
            BladeModel.AddPoint(b, Vec3.CreateVec3(b, *point))
            BladeModel.AddNormal(b, Vec3.CreateVec3(b, *normal))
            BladeModel.AddStiffness(b, matrix)
            BladeModel.AddDampingNSPerM(b, damping)
            BladeModel.AddResistanceN(b, resistance)
            BladeModel.AddValidForNs(b, int(valid_s * 1e9))
            return int(BladeModel.End(b))

        self._send(Body.Body.BladeModel, build)
        return self._sequence

    def send_field(self, name: str, values: Any, *, tets: bool = False, first: int = 0, revision: Optional[int] = None) -> int:
        """For roles Simulator and Admin: sets a field of the body for everybody, on the vertices, or with ``tets`` on the tetrahedra.

        ``values`` is (n,) or (n, components), for the ids ``first``, ``first + 1``, ... as they were at ``revision``, by default the
        replica's; rows that a cut has made or changed since stay as they are. A refusal comes as ``error``. Returns the message's
        sequence. Raises ValueError where the body has no such field, or values do not fit it.
        """
        on = FieldOn.FieldOn.Tets if tets else FieldOn.FieldOn.Vertices
        there = [self.welcome.Fields(k) for k in range(self.welcome.FieldsLength())]
        place = next((k for k, facts in enumerate(there) if facts.On() == on and _text(facts.Name()) == name), None)
        if place is None:
            here = [repr(_text(facts.Name())) for facts in there if facts.On() == on]
            elsewhere = any(facts.On() != on and _text(facts.Name()) == name for facts in there)
            raise ValueError(f"the body has no field {name!r} on its {'tetrahedra' if tets else 'vertices'}; "
                             + (f"it is on its {'vertices' if tets else 'tetrahedra'}: give tets={not tets}" if elsewhere
                                else f"there it has {', '.join(here) or 'none'}"))
        array = np.asarray(values)
        whole, components = there[place].Whole(), there[place].Components()
        shaped = array.ndim == 1 and components == 1 or array.ndim == 2 and array.shape[1] == components
        if not shaped or whole and array.dtype.kind not in "iu" or array.dtype.kind not in "iuf":
            raise ValueError(f"values: found {array.dtype} of shape {array.shape}; accepted for {name!r} are "
                             f"{'whole numbers' if whole else 'numbers'} of shape (n{', %d' % components if components > 1 else ''})")
        flat = np.ascontiguousarray(array, "<i4" if whole else "<f4").reshape(-1)

        def build(b: Any) -> int:
            vector = b.CreateNumpyVector(flat)
            return _table(b, FieldValues, [("I32" if whole else "F32", vector), ("Field", place), ("First", first),
                                           ("Revision", self.replica.revision if revision is None else revision)])

        self._send(Body.Body.FieldValues, build, flat.nbytes)
        return self._sequence

    def engage(self) -> None:
        """For a tool without a button: engages the blade for all poses sent from here on, until end_stroke()."""
        self._send(Body.Body.StrokeControl, lambda b: _table(b, StrokeControl, [("Action", StrokeAction.StrokeAction.Engage)]))

    def end_stroke(self) -> None:
        """Ends the running stroke after the poses sent so far."""
        self._send(Body.Body.StrokeControl, lambda b: _table(b, StrokeControl, [("Action", StrokeAction.StrokeAction.End)]))

    def reset(self) -> None:
        """For role Admin: puts the body back as it was loaded, for everybody. A new snapshot comes when it is done; where it cannot be, `error` is set."""
        self._send(Body.Body.Reset, lambda b: _table(b, Reset, []))

    def undo(self, others: bool = False) -> None:
        """Asks for the state before a stroke that cut something, for everybody: the last one of the operator's own blade, an admin's is the last one of all.
        An operator's is refused while another blade is in a stroke, and where others have cut since its stroke began: with ``others`` that is undone, too. The last stroke is the one that began last.
        Strokes from before the server's start stay. A new snapshot comes when it is done; where it cannot be, `error` is set, and `error.Text()` says why. Begin the next stroke afterwards:
        where one begins before it is done, nothing is undone."""
        self._send(Body.Body.Undo, lambda b: _table(b, Undo, [("Others", others)]))

    def _send_hello(self, role: int, view: int, token: str, source_name: str, take_over: bool, blade: Any,
                    max_rate_hz: float, box: Any, session: int, load_rate_hz: float, fields: Sequence[str]) -> None:
        def build(b: Any) -> int:
            name, source, secret = b.CreateString("incise_client.py"), b.CreateString(source_name), b.CreateString(token)
            optional = [("Box", _box(b, box))] if box else []
            if fields:
                names = [b.CreateString(field) for field in fields]
                Hello.StartFieldsVector(b, len(names))
                for offset in reversed(names):
                    b.PrependUOffsetTRelative(offset)
                optional.append(("Fields", b.EndVector()))
            if blade:
                BladeEdge.Start(b)
                BladeEdge.AddHeel(b, Vec3.CreateVec3(b, *blade[0]))
                BladeEdge.AddTip(b, Vec3.CreateVec3(b, *blade[1]))
                optional.append(("Blade", BladeEdge.End(b)))
            return _table(b, Hello, optional + [("ProtocolVersion", 2), ("Role", role), ("View", view), ("ClientName", name),
                                     ("Token", secret), ("SourceName", source), ("TakeOver", take_over),
                                     ("MaxRateHz", max_rate_hz), ("LoadRateHz", load_rate_hz), ("ResumeSession", session),
                                     ("ResumeRevision", self.replica.revision if session else 0),
                                     ("ResumeHash", self._state_hash if session else 0)])

        self._send(Body.Body.Hello, build)

    def _send(self, kind: int, build: Callable[[Any], int], array_bytes: int = 0) -> None:
        self._demand_open()
        builder = flatbuffers.Builder(array_bytes + 1024)
        body = build(builder)
        self._sequence += 1
        message = _table(builder, Message, [("Sequence", self._sequence), ("SentNs", time.monotonic_ns()),
                                            ("BodyType", kind), ("Body", body)])
        builder.Finish(message, file_identifier=b"INC1")
        data = bytes(builder.Output())
        try:
            self._socket.settimeout(10)
            self._socket.sendall(struct.pack("<I", len(data)) + data)
        except OSError as error:
            raise ConnectError(f"the connection has ended: {error}") from error


def _table(builder: Any, module: Any, fields: list[tuple[str, Any]]) -> int:
    module.Start(builder)
    for name, value in fields:
        getattr(module, "Add" + name)(builder, value)
    return int(module.End(builder))


def _box(builder: Any, box: Any) -> int:
    Box.Start(builder)
    Box.AddMin(builder, Vec3.CreateVec3(builder, *box[0]))
    Box.AddMax(builder, Vec3.CreateVec3(builder, *box[1]))
    return int(Box.End(builder))


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if value else ""


def connect(host: str, port: int, **options: Any) -> Client:
    """Connects and waits for Welcome; see Client for the options. Raises ConnectError."""
    return Client(host, port, **options)
