"""Data sets of cuts: bodies x motions x parameters, as HDF5 shards. The command is `incise sweep SPEC --out DIRECTORY`.

SPEC is JSON; paths in it are relative to it::

    {
      "bodies": ["liver.node", {"phantom": "slab", "tets": 3000}],
      "motions": ["pass.tum", {"random_cuts": 100, "seed": 1}],
      "parameters": {"cut.prefer": ["balanced", "exact"]},
      "config": {"blade": {"heel": [0, 0, 0], "tip": [0, 0, -0.12]}},
      "store": ["states", "deltas", "forces"]
    }

- motions: files as `incise cut --poses` takes them, and seeded random cuts: planes through a random point of the body.
- parameters: keys of the configuration (sections cut, blade, haptics) with the values that each takes; all combinations are made.
- config: what all samples have in common. store: what is kept beside poses, report and hash (default: states).

Samples are numbered from 0: the last parameter changes fastest, then the motions, then the bodies. A shard holds up to 20 samples, each a
group named by its number, eight digits: ``poses`` (n, 8), ``forces`` (n, 3), ``state/positions``, ``state/tets``, ``state/pieces``,
``deltas/REVISION/...`` as in incise.Delta, and the attributes body, motion, parameters, report (JSON), state_hash (16 hexadecimal
digits) and line, the command that makes this sample again. manifest.json lists shards and hashes.

A shard is written whole or not at all, so a sweep that was interrupted goes on where it was when it is started again, and a worker
that dies loses at most the shard that it was working on, which is then given to another. The same SPEC gives the same bytes on any worker.

Needs python3-h5py, and python3-distributed for --dask.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import functools
import hashlib
import io
import itertools
import json
import logging
import math
import multiprocessing
import multiprocessing.connection
import os
import pathlib
import random
import sys
import time
import warnings
from typing import Any, Callable, Iterator

import incise

FORMAT = 1
SAMPLES_PER_SHARD = 20
MAX_ATTEMPTS = 5  # of a shard, before whatever kills its workers is given up on
STORES = ("states", "deltas", "forces")
SECTIONS = ("cut", "blade", "haptics")
# Of a delta, what is kept.
DELTA_ARRAYS = ("moved", "moved_positions", "added_positions", "provenance", "blends", "upserted", "elders", "removed",
                "boundary_upserted", "boundary_removed", "pieces")

Plan = dict[str, Any]


def _refuse(where: str, found: Any, accepted: str) -> None:
    raise incise.Error(f"{where}: found {json.dumps(found)}; accepted is {accepted}")


def _only(where: str, given: dict, known: tuple[str, ...]) -> None:
    for key in given:
        if key not in known:
            raise incise.Error(f"{where}: unknown key {json.dumps(key)}; accepted are {', '.join(known)}")


# --- The plan: what the samples are ---------------------------------------------------------------------------------


def read_plan(path: pathlib.Path) -> Plan:
    """The plan of a SPEC, checked: all that a worker needs. Raises incise.Error."""
    try:
        spec = json.loads(path.read_text())
    except OSError as error:
        raise incise.Error(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise incise.Error(f"{path}: is no JSON ({error}); client/CLIENTS.md shows what a SPEC is") from None
    where = str(path)
    if not isinstance(spec, dict):
        _refuse(where, spec, "an object {...}")
    _only(where, spec, ("bodies", "motions", "parameters", "config", "store"))
    for key in ("bodies", "motions"):
        if not isinstance(spec.get(key), list) or not spec[key]:
            _refuse(f"{where}: {key}", spec.get(key), "a list of one or more")
    parameters = spec.setdefault("parameters", {})
    if not isinstance(parameters, dict) or not all(isinstance(values, list) and values for values in parameters.values()):
        _refuse(f"{where}: parameters", parameters, "an object of lists")
    for key in parameters:
        if key.split(".")[0] not in SECTIONS or key.count(".") != 1:
            _refuse(f"{where}: parameters", key, f"a key of the sections {', '.join(SECTIONS)}, such as cut.prefer")
    store = spec.setdefault("store", ["states"])
    if not isinstance(store, list) or not all(one in STORES for one in store):
        _refuse(f"{where}: store", store, f"a list of {', '.join(STORES)}")
    if not isinstance(spec.setdefault("config", {}), dict):
        _refuse(f"{where}: config", spec["config"], "an object {...}")
    plan = {"format": FORMAT, "software": incise.__version__, "spec": spec, "directory": str(path.resolve().parent)}
    for entry in spec["bodies"]:
        _check_body(f"{where}: bodies", entry)
    plan["bodies"] = [_body(plan, number).content_hash for number in range(len(spec["bodies"]))]
    plan["motions"] = list(_motions(where, spec["motions"], plan["directory"]))
    plan["motion_count"] = len(plan["motions"])
    for choice in _choices(plan):  # the configuration's own errors, before anything is cut
        incise.Session(_body(plan, 0), _config(plan, choice))
    # Where the files lie does not matter, nor what makes no difference to the samples.
    plan["digest"] = hashlib.sha256(json.dumps([plan[key] for key in ("format", "software", "spec", "bodies", "motions")],
                                               sort_keys=True).encode()).hexdigest()
    plan["samples"] = len(plan["bodies"]) * plan["motion_count"] * len(_choices(plan))
    return plan


@functools.lru_cache(maxsize=4)
def _load(entry_text: str, config_text: str, directory: str) -> incise.Body:
    entry = json.loads(entry_text)
    if isinstance(entry, str):
        return incise.Body.load(pathlib.Path(directory) / entry, json.loads(config_text))
    return incise.Body.phantom(entry["phantom"], entry.get("tets", 60_000))


def _body(plan: Plan, number: int) -> incise.Body:
    """A body of the plan; the last few are kept."""
    return _load(json.dumps(plan["spec"]["bodies"][number]), json.dumps(plan["spec"]["config"]), plan["directory"])


def _check_body(where: str, entry: Any) -> None:
    if isinstance(entry, str):
        return
    if not isinstance(entry, dict) or not isinstance(entry.get("phantom"), str) or not isinstance(entry.get("tets", 1), int):
        _refuse(where, entry, 'a path or {"phantom": KIND, "tets": N}')
    _only(where, entry, ("phantom", "tets"))


def _motions(where: str, entries: list, directory: str) -> Iterator[dict]:
    """Each motion: a file and the digest of its bytes, or a random cut's seed."""
    for entry in entries:
        if isinstance(entry, str):
            incise.Motion.load(pathlib.Path(directory) / entry)  # raises if it is none
            yield {"file": entry, "sha256": hashlib.sha256((pathlib.Path(directory) / entry).read_bytes()).hexdigest()}
            continue
        if not isinstance(entry, dict) or not isinstance(entry.get("random_cuts"), int) or not 0 < entry["random_cuts"] < 10**7:
            _refuse(f"{where}: motions", entry, 'a path or {"random_cuts": N, "seed": S}')
        _only(f"{where}: motions", entry, ("random_cuts", "seed"))
        for number in range(entry["random_cuts"]):
            yield {"seed": f"{entry.get('seed', 0)}/{number}"}


def _choices(plan: Plan) -> list[dict]:
    """All combinations of the parameters' values."""
    parameters = plan["spec"]["parameters"]
    return [dict(zip(parameters, values)) for values in itertools.product(*parameters.values())]


def _config(plan: Plan, choice: dict) -> dict:
    config = json.loads(json.dumps(plan["spec"]["config"]))
    for key, value in choice.items():
        section, leaf = key.split(".")
        config.setdefault(section, {})[leaf] = value
    return config


# --- A sample -------------------------------------------------------------------------------------------------------


def _random_cut(body: incise.Body, seed: str) -> incise.Motion:
    """A plane through a random point in the middle of the body's box. Plain arithmetic: the same bits on every machine."""
    source = random.Random(seed)

    def direction() -> list[float]:
        while True:
            v = [source.uniform(-1, 1) for _ in range(3)]
            length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
            if 0.1 < length < 1:
                return [x / length for x in v]

    low, high = body.points.min(axis=0).tolist(), body.points.max(axis=0).tolist()
    through = [a + source.uniform(0.3, 0.7) * (b - a) for a, b in zip(low, high)]
    size = math.sqrt(sum((b - a) * (b - a) for a, b in zip(low, high)))
    along = direction()
    while True:
        other = direction()
        share = sum(a * b for a, b in zip(along, other))
        across = [b - share * a for a, b in zip(along, other)]
        length = math.sqrt(sum(x * x for x in across))
        if length > 0.1:
            break
    lines = []
    for side in (-1, 1):
        middle = [p + side * size * a for p, a in zip(through, along)]
        lines.append([[m - way * size * x / length for m, x in zip(middle, across)] for way in (1, -1)])
    return incise.Motion.lines(lines, name=f"random cut {seed}")


def _place(plan: Plan, sample: int) -> tuple[int, int, dict]:
    """Which body, motion and choice of parameters a sample has."""
    choices = _choices(plan)
    rest, choice = divmod(sample, len(choices))
    return *divmod(rest, plan["motion_count"]), choices[choice]


def make_sample(plan: Plan, number: int, store: list[str]) -> tuple[dict, incise.Motion, incise.Cut]:
    """Cuts one sample: its attributes, the motion and the cut. Raises incise.Error, which names the sample."""
    body_number, motion_number, choice = _place(plan, number)
    spec, motion_entry = plan["spec"], plan["motions"][motion_number]
    try:
        body = _body(plan, body_number)
        if body.content_hash != plan["bodies"][body_number]:
            raise incise.Error(f"{body.name} is another mesh here than where the sweep was started")
        if "seed" in motion_entry:
            motion = _random_cut(body, motion_entry["seed"])
        else:
            file = pathlib.Path(plan["directory"]) / motion_entry["file"]
            if hashlib.sha256(file.read_bytes()).hexdigest() != motion_entry["sha256"]:
                raise incise.Error(f"{file} has changed since the sweep was started")
            motion = incise.Motion.load(file)
        cut = incise.cut(body, motion, config=_config(plan, choice), deltas="deltas" in store, forces="forces" in store)
    except (incise.Error, ValueError, OSError) as error:
        raise incise.Error(f"sample {number}: {error}") from None
    report = dict(cut.report, mesh=str(spec["bodies"][body_number]), poses=motion_entry.get("file", motion.name))
    del report["cut_time_us"]  # the only thing that another run would not repeat
    return {"body": json.dumps(spec["bodies"][body_number]), "body_content_hash": body.content_hash, "motion": json.dumps(motion_entry),
            "parameters": json.dumps(choice), "report": json.dumps(report), "state_hash": report["state_hash"]}, motion, cut


def make_shard(plan: Plan, shard: int) -> bytes:
    """The HDF5 file of a shard. Depends on the plan and the shard alone."""
    import h5py

    store = plan["spec"]["store"]
    memory = io.BytesIO()
    with h5py.File(memory, "w", libver=("earliest", "v110"), track_order=False) as file:
        file.attrs["plan"] = plan["digest"]
        for number in _samples_of(plan, shard):
            attributes, motion, cut = make_sample(plan, number, store)
            group = file.create_group(f"{number:08}", track_order=False)
            for key, value in attributes.items():
                group.attrs[key] = value
            group.attrs["line"] = f"incise sweep SPEC --sample {number}"
            arrays = {"poses": motion.poses}
            if "forces" in store:
                arrays["forces"] = cut.forces
            if "states" in store:
                session = cut.session
                arrays |= {"state/positions": session.positions(), "state/tets": session.tets(), "state/pieces": session.pieces()}
            for delta in cut.deltas:
                arrays |= {f"deltas/{delta.revision:08}/{name}": getattr(delta, name) for name in DELTA_ARRAYS}
            for name, array in arrays.items():
                group.create_dataset(name, data=_without_padding(array), track_times=False)
    return memory.getvalue()


def _without_padding(array: Any) -> Any:
    """A structured array without the bytes between its fields, which are whatever was there before."""
    import numpy as np

    if array.dtype.names is None:
        return array
    packed = np.empty(array.shape, [(name, array.dtype[name]) for name in array.dtype.names])
    for name in array.dtype.names:
        packed[name] = array[name]
    return packed


# --- Shards and the manifest ----------------------------------------------------------------------------------------


def _shards(plan: Plan) -> int:
    return -(-plan["samples"] // SAMPLES_PER_SHARD)


def _samples_of(plan: Plan, shard: int) -> range:
    return range(shard * SAMPLES_PER_SHARD, min((shard + 1) * SAMPLES_PER_SHARD, plan["samples"]))


def _part(plan: Plan, shard: int) -> Plan:
    """The plan with the motions that this shard needs alone: there may be a million."""
    numbers = {_place(plan, sample)[1] for sample in _samples_of(plan, shard)}
    return dict(plan, motions={number: plan["motions"][number] for number in numbers})


def _shard_file(out: pathlib.Path, shard: int) -> pathlib.Path:
    return out / f"shard-{shard:06}.h5"


def write_whole(path: pathlib.Path, content: bytes) -> None:
    """Writes a file that is there with all of its content or not at all, also if the machine stops."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(part, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink()
        raise incise.Error(f"{path}: cannot be written: {error.strerror}; when it can, start the sweep again, and it goes on") from None


def _state_hashes(plan: Plan, path: pathlib.Path, shard: int) -> list[str]:
    """Of a shard that is there. Raises incise.Error if it is not of this plan."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            if file.attrs["plan"] != plan["digest"]:
                raise incise.Error(f"{path}: is of another sweep; choose another --out")
            return [file[f"{number:08}"].attrs["state_hash"] for number in _samples_of(plan, shard)]
    except (OSError, KeyError) as error:
        raise incise.Error(f"{path}: cannot be read ({error}); remove it, and its samples are made again") from None


def _digest(manifest: pathlib.Path) -> str | None:
    """Of the plan that a manifest is of."""
    try:
        return json.loads(manifest.read_text()).get("digest")
    except (OSError, ValueError, AttributeError) as error:
        raise incise.Error(f"{manifest}: cannot be read ({error}); remove it, and it is made again") from None


def _write_manifest(plan: Plan, out: pathlib.Path, done: dict[int, list[str]]) -> None:
    shards = [{"file": _shard_file(out, shard).name, "first": _samples_of(plan, shard).start, "state_hashes": done[shard]}
              for shard in sorted(done)]
    manifest = {key: plan[key] for key in ("format", "software", "digest", "spec", "samples")}
    manifest |= {"body_content_hashes": plan["bodies"], "complete": len(done) == _shards(plan), "shards": shards}
    write_whole(out / "manifest.json", (json.dumps(manifest, indent=1) + "\n").encode())


# --- Workers --------------------------------------------------------------------------------------------------------


def _work(plan: Plan, out: pathlib.Path, shard: int, lock: int, answer: Any) -> None:
    """A local worker's whole life."""
    try:
        os.close(lock)
        write_whole(_shard_file(out, shard), make_shard(plan, shard))
    except Exception as error:  # pylint: disable=broad-except
        answer.send(str(error))
        os._exit(1)
    os._exit(0)


def run_local(plan: Plan, out: pathlib.Path, wanted: list[int], workers: int, lock: int, finished: Callable[[int], None]) -> None:
    """A process for each shard, `workers` at a time. A worker that is killed costs its shard one more attempt. `lock`: a file that
    workers must not keep open."""
    fork = multiprocessing.get_context("fork")  # bodies that the plan has loaded need not be loaded again
    waiting, attempts, running = list(reversed(wanted)), dict.fromkeys(wanted, 0), {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                shard = waiting.pop()
                ours, theirs = fork.Pipe(duplex=False)
                process = fork.Process(target=_work, args=(plan, out, shard, lock, theirs))
                process.start()
                theirs.close()
                attempts[shard] += 1
                running[process.sentinel] = (shard, process, ours)
            for sentinel in multiprocessing.connection.wait(list(running)):
                shard, process, ours = running.pop(sentinel)
                process.join()
                if process.exitcode == 0:
                    finished(shard)
                elif ours.poll() and process.exitcode == 1:
                    raise incise.Error(ours.recv())
                elif attempts[shard] >= MAX_ATTEMPTS:
                    raise incise.Error(f"samples {_samples_of(plan, shard)[0]} to {_samples_of(plan, shard)[-1]}: {MAX_ATTEMPTS} workers died "
                                       f"(the last with status {process.exitcode}); is there enough memory?")
                else:
                    waiting.append(shard)
                ours.close()
    finally:
        for shard, process, ours in running.values():
            process.kill()
            process.join()


def run_dask(plan: Plan, out: pathlib.Path, wanted: list[int], address: str, finished: Callable[[int], None]) -> None:
    """The same on a Dask cluster, whose workers need incise, h5py and the files under the same names; they send the shards back."""
    try:
        from distributed import Client, as_completed
    except ModuleNotFoundError as error:
        raise incise.Error(f"--dask needs python3-distributed ({error})") from None
    for name in ("asyncio", "distributed"):  # our own errors say it in one line
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=5)
    except (OSError, ValueError) as error:
        raise incise.Error(f"--dask {address}: no scheduler answers ({str(error).splitlines()[0]})") from None
    with client:
        # Each task carries what it needs: data that is scattered dies with the workers that hold it.
        futures = {client.submit(make_shard, _part(plan, shard), shard, pure=False): shard for shard in wanted}
        for future in as_completed(futures):
            if future.status == "error":
                hint = "; install python3-incise and python3-h5py there" if isinstance(future.exception(), ModuleNotFoundError) else ""
                raise incise.Error("a Dask worker: " + f"{future.exception()}".splitlines()[0] + hint)
            write_whole(_shard_file(out, futures[future]), future.result())
            finished(futures[future])
            future.release()


# --- The command ----------------------------------------------------------------------------------------------------


def _require_not_read(plan: Plan, spec: pathlib.Path, out: pathlib.Path) -> None:
    """Raises incise.Error if a mesh that is written as `out` would overwrite what the sweep reads. A TetGen mesh is two files."""
    def files(path: pathlib.Path) -> list[pathlib.Path]:
        base = path.with_suffix("") if path.suffix in (".node", ".ele") else path
        return [file for file in (path, pathlib.Path(f"{base}.node"), pathlib.Path(f"{base}.ele")) if file.exists()]

    named = [entry for entry in plan["spec"]["bodies"] + plan["spec"]["motions"] if isinstance(entry, str)]
    for file in itertools.chain([spec], *(files(pathlib.Path(plan["directory"]) / name) for name in named)):
        if any(file.samefile(written) for written in files(out)):
            raise incise.Error(f"--out {out}: would overwrite {file}, which is read; choose another name")


def sweep(spec: pathlib.Path, out: pathlib.Path, workers: int, dask: str | None) -> dict:
    """Makes what is missing of a data set; returns figures. Raises incise.Error."""
    begun = time.monotonic()
    plan = read_plan(spec)
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = open(out / ".lock", "w", encoding="ascii")
    except OSError as error:
        raise incise.Error(f"--out {out}: cannot be the data set's directory: {error.strerror}; choose another") from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise incise.Error(f"{out}: another sweep is writing there; wait for it, or choose another --out") from None
        return _continue(plan, out, workers, dask, lock.fileno(), begun)


def _continue(plan: Plan, out: pathlib.Path, workers: int, dask: str | None, lock: int, begun: float) -> dict:
    manifest = out / "manifest.json"
    if manifest.exists() and _digest(manifest) != plan["digest"]:
        raise incise.Error(f"{out}: holds a sweep of another SPEC, body, motion or version; choose another --out")
    for part in out.glob(".*.part"):  # of a sweep that was killed
        part.unlink()
    done = {shard: _state_hashes(plan, _shard_file(out, shard), shard) for shard in range(_shards(plan)) if _shard_file(out, shard).exists()}
    _write_manifest(plan, out, done)
    wanted = [shard for shard in range(_shards(plan)) if shard not in done]
    figures = {"samples": plan["samples"], "made": sum(len(_samples_of(plan, shard)) for shard in wanted), "shards": _shards(plan),
               "preparing_s": time.monotonic() - begun}

    def finished(shard: int) -> None:
        done[shard] = _state_hashes(plan, _shard_file(out, shard), shard)
        if sys.stderr.isatty():
            print(f"\r{len(done)} of {_shards(plan)} shards", end="\n" if len(done) == _shards(plan) else "", file=sys.stderr)

    try:
        if dask:
            run_dask(plan, out, wanted, dask, finished)
        else:
            run_local(plan, out, wanted, workers, lock, finished)
    finally:
        _write_manifest(plan, out, done)
    figures["seconds"] = time.monotonic() - begun
    return figures


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def main(arguments: list[str] | None = None) -> int:
    """`incise sweep`."""
    parser = argparse.ArgumentParser("incise sweep")
    parser.add_argument("spec", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--dask")
    parser.add_argument("--sample", type=int)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    try:
        if options.sample is not None:
            plan = read_plan(options.spec)
            if not 0 <= options.sample < plan["samples"]:
                raise incise.Error(f"--sample {options.sample}: accepted is 0 to {plan['samples'] - 1}")
            attributes, _, cut = make_sample(plan, options.sample, [])
            if options.out:
                _require_not_read(plan, options.spec, options.out)
                with warnings.catch_warnings(record=True) as told:
                    warnings.simplefilter("always")
                    cut.session.save(options.out)
                for warning in told:
                    print(f"warning: {warning.message}", file=sys.stderr)
            result = {key: json.loads(attributes[key]) for key in ("body", "motion", "parameters", "report")}
            print(json.dumps(result, indent=2) if options.json else
                  f"sample {options.sample}: {attributes['body']} {attributes['motion']} {attributes['parameters']}: "
                  f"{result['report']['pieces']} pieces, state hash {attributes['state_hash']}" +
                  (f"; written to {options.out}" if options.out else ""))
        else:
            figures = sweep(options.spec, options.out, options.workers, options.dask)
            print(json.dumps(figures, indent=2) if options.json else
                  f"{_count(figures['samples'], 'sample')} in {_count(figures['shards'], 'shard')}; {figures['made']} made now in {figures['seconds']:.1f} s")
        sys.stdout.flush()
    except OSError as error:
        if error.filename is None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python tries once more at its end
        what = "the standard output could not be written to its end" if error.filename is None else f"{error.filename}: cannot be used"
        print(f"incise: {what}: {error.strerror}", file=sys.stderr)
        return 1
    except (incise.Error, ValueError) as error:
        print(f"incise: {error}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        print(f"incise: sweep needs h5py (Debian: python3-h5py): {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("incise: interrupted; start it again to go on", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    import incise.sweep  # Dask's workers find make_shard by its module's name, which is not __main__ there

    sys.exit(incise.sweep.main())
