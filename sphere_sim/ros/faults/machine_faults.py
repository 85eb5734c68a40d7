# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the machine (no compiler, full disk, ...) and the checks of commands under them.

None of them needs root.
"""

import os
import re
import resource
import socket
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sphere_sim.faults.outcome import Outcome
from sphere_sim.ros.faults.scratch_home import ScratchHome

NOWHERE = "/dev/null"
"""A file: no folder can be created below it, not even by root."""
_ONE_RUN = ("--draw", "1", "--seed", "1", "--duration", "2", "--jobs", "1")
_STUDY = (*_ONE_RUN, "--no-bound")
_DEMO = ("demo", "--rtf", "0", "--case", "3", "--no-compare", "--no-viewer")
_SERVED = (200, 302)
"""HTTP status of a page that is served or redirected."""
_RESULTS = ("runs.csv", "summary.json", "inputs.npz")
_PATIENCE = 5.0
"""Time in which a command has to end after Ctrl-C [s]; an idle machine needs less than one."""

Complaints = list[str]


@dataclass(frozen=True)
class MachineFault:
    """A fault of the machine on which commands run.

    Attributes
    ----------
    name : str
        As on the command line and in the table.
    check : callable
        Runs commands in a scratch home and returns the complaints about their results.
    quick : bool
        Whether the quick campaign includes it.
    group : str
        Its group on the command line.
    """

    name: str
    check: Callable[[ScratchHome], Complaints]
    quick: bool = False
    group: str = "machine"

    def run(self) -> Outcome:
        """Try the fault in a new scratch home."""
        with tempfile.TemporaryDirectory(prefix="sphere_nmpc_machine_") as folder:
            return Outcome(self.name, complaints=tuple(self.check(ScratchHome(Path(folder)))))


def _study(out: Path, *more: str) -> list[str]:
    return ["study", *(more or _STUDY), "--out", str(out)]


def _lacking(out: Path) -> Complaints:
    return [f"there is no {name}" for name in _RESULTS if not (out / name).exists()]


def _home_missing(home: ScratchHome) -> Complaints:
    lacking = {"HOME": f"{NOWHERE}/home", "SPHERE_NMPC_CACHE": None}
    out = home.fresh()
    found = home.run(_study(out), lacking).complaints(0) + _lacking(out)
    with home.running(["simulator"], lacking) as node:
        if not node.wait_for(lambda: "ROS domain" in node.errors):
            found.append("the simulator does not start")
        node.interrupt()
        return found + node.result().complaints(0)


def _home_unset(home: ScratchHome) -> Complaints:
    out = home.fresh()
    return home.run(_study(out), {"HOME": None}).complaints(0) + _lacking(out)


def _cache_refused(home: ScratchHome) -> Complaints:
    out, refused = home.fresh(), {"SPHERE_NMPC_CACHE": f"{NOWHERE}/cache"}
    result = home.run(_study(out, *_ONE_RUN), refused)
    return result.complaints(0, "/dev/null/cache") + _lacking(out)


def _no_compiler(home: ScratchHome) -> Complaints:
    out, lacking = home.fresh(), {"CC": "nonesuch"}
    found = home.run(_study(out), lacking).complaints(0, "no C compiler found", lines=2)
    found += _lacking(out)
    long = _study(out := home.fresh(), "--draw", "50", "--jobs", "2", "--no-bound")
    with home.running(long, lacking) as study:
        study.wait_for(lambda: _size(out / "journal.jsonl") > 0)
        study.wait_for(lambda: False, 3.0)
        study.interrupt()
        ended = study.result()
    if ended.seconds > _PATIENCE:
        found.append(f"ended {ended.seconds:.1f} s after Ctrl-C")
    return found + ended.complaints(130, "interrupted")


def _compiler_misspelt(home: ScratchHome) -> Complaints:
    out = home.fresh()
    return home.run(_study(out), {"CC": 'gcc "'}).complaints(0, "CC") + _lacking(out)


def _disk_full(home: ScratchHome) -> Complaints:
    out = home.fresh()
    home.run(_study(home.fresh()))  # compiles the solver while there is enough space
    several = _study(out, "--draw", "4", *_STUDY[2:])
    ended = home.run(several, limits={resource.RLIMIT_FSIZE: 2500})
    found = [] if ended.code else ["exit code 0 although the disk was full"]
    found += ended.complaints(ended.code, str(out))
    return found + home.run(several).complaints(0) + _lacking(out)


def _journal_damaged(home: ScratchHome) -> Complaints:
    out = home.fresh()
    words = _study(out, "--draw", "3", *_STUDY[2:])
    found = home.run(words).complaints(0)
    journal = out / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    damaged = [lines[0], lines[1], b"\x00\xff\n", lines[2].replace(b'"run": ', b'"run": 77')]
    journal.write_bytes(b"".join(damaged))
    return found + home.run(words).complaints(0, "journal.jsonl") + _lacking(out)


def _output_full(home: ScratchHome) -> Complaints:
    out = home.fresh()
    ended = home.run(_study(out), output=Path("/dev/full"))
    return ended.complaints(1, "standard output: No space left on device") + _lacking(out)


def _reader_gone(home: ScratchHome) -> Complaints:
    inlet, outlet = os.pipe()
    os.close(inlet)
    out = home.fresh()
    try:
        return home.run(_study(out), output=outlet).complaints(0) + _lacking(out)
    finally:
        os.close(outlet)


def _ascii_only(home: ScratchHome) -> Complaints:
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    out = home.fresh("prüfung")
    return home.run(_study(out), plain).complaints(0) + _lacking(out)


def _few_files(home: ScratchHome) -> Complaints:
    words = _study(home.fresh(), "--draw", "4", "--duration", "2", "--jobs", "2", "--no-bound")
    ended = home.run(words, limits={resource.RLIMIT_NOFILE: 40})
    # Either the command works with so few, or it names the resource.
    return ended.complaints(0) if ended.code == 0 else ended.complaints(1, "open files")


def _nowhere_to_write(home: ScratchHome) -> Complaints:
    found = []
    for verb in (["study", *_STUDY], list(_DEMO), ["report", "any_bag"]):
        ended = home.run([*verb, "--out", f"{NOWHERE}/out"])
        found += [f"{verb[0]}: {text}" for text in ended.complaints(2, f"{NOWHERE}/out", lines=1)]
    return found


def _endless_file(home: ScratchHome) -> Complaints:
    words = ["study", "--scenarios", "/dev/zero", "--out", str(home.fresh())]
    return home.run(words).complaints(2, "/dev/zero", lines=1)


def _domain_misspelt(home: ScratchHome) -> Complaints:
    found = []
    for verb in (["simulator"], [*_DEMO, "--out", str(home.fresh())]):
        ended = home.run(verb, {"ROS_DOMAIN_ID": "abc"})
        found += [f"{verb[0]}: {text}" for text in ended.complaints(2, "ROS_DOMAIN_ID", "abc")]
    return found


def _two_demos(home: ScratchHome) -> Complaints:
    # In the domain of the campaign, whose own nodes have ended.
    domain = {"ROS_DOMAIN_ID": os.environ["ROS_DOMAIN_ID"]}
    first, second = home.fresh(), home.fresh()
    slow = ["demo", "--no-compare", "--no-viewer", "--out", str(first)]
    with home.running(slow, domain, output=home.folder / "first.txt") as demo:
        if not demo.wait_for(lambda: "distance" in (home.folder / "first.txt").read_text()):
            return ["the first demo does not start"]
        ended = home.run([*_DEMO, "--out", str(second)], domain)
        found = [f"second: {text}" for text in ended.complaints(1, "simulator", "ROS_DOMAIN_ID")]
        return found + [f"first: {text}" for text in demo.result().complaints(0)]


def _bag_cut_short(home: ScratchHome) -> Complaints:
    out = home.fresh()
    found = home.run([*_DEMO, "--out", str(out)]).complaints(0)
    bag = next((out / "bag").glob("*.mcap"))
    content = bag.read_bytes()
    for share in (0.5, 0.9):
        bag.write_bytes(content[: int(share * len(content))])
        ended = home.run(["report", str(out / "bag"), "--out", str(home.fresh())])
        found += [f"{share:.0%} of a bag: {text}" for text in ended.complaints(0, "is truncated")]
    return found


def _foreign_page(home: ScratchHome) -> Complaints:
    printed = home.folder / "viewer.txt"
    with home.running(["viewer", "--port", "0"], output=printed) as viewer:
        page = r"http://127\.0\.0\.1:(\d+)(/\S*)?"
        if not viewer.wait_for(lambda: re.search(page, printed.read_text()) is not None):
            return ["the viewer does not start"]
        port, path = re.findall(page, printed.read_text())[0]
        found = _handshakes(int(port), path or "/")
        _send_garbage(int(port))
        if _status(int(port), path or "/", "") not in _SERVED:
            found.append("no page after garbage")
        viewer.interrupt()
        return found + viewer.result().complaints(0)


def _handshakes(port: int, path: str) -> Complaints:
    """Request a WebSocket as pages of other sites, and pages without the token, would."""
    upgrade = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    upgrade += "Sec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==\r\n"
    own = f"Origin: http://127.0.0.1:{port}\r\n"
    tries = {
        "a foreign origin": _status(port, path, upgrade + "Origin: http://evil.example\r\n"),
        "no token": _status(port, "/", upgrade + own),
        "a foreign host": _status(port, path, upgrade + own, host="evil.example"),
    }
    return [f"a WebSocket for {who}: {got}" for who, got in tries.items() if got not in (0, 403)]


def _status(port: int, path: str, headers: str, host: str = "") -> int:
    """Return the status of an answer to GET; 0 where the connection is closed instead."""
    host = host or f"127.0.0.1:{port}"
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as link:
        link.sendall(f"GET {path} HTTP/1.1\r\nHost: {host}\r\n{headers}\r\n".encode())
        words = link.recv(4096).split()
    return int(words[1]) if len(words) > 1 else 0


def _send_garbage(port: int) -> None:
    for garbage in (b"\x00" * 64, b"GET / HTTP/9.9\r\n\r\n", os.urandom(2000), b"\r\n\r\n"):
        with socket.create_connection(("127.0.0.1", port), timeout=20.0) as link:
            link.sendall(garbage)


def _far_start(home: ScratchHome) -> Complaints:
    out, file = home.fresh(), home.fresh("far.csv")
    state = "x,y,qw,qx,qy,qz"
    goal = ",".join(f"goal_{name}" for name in state.split(","))
    file.write_text(f"{state},{goal}\n100000,0,1,0,0,0,0,0,1,0,0,0\n", encoding="utf-8")
    ended = home.run(["study", "--scenarios", str(file), *_STUDY[4:], "--out", str(out)])
    return ended.complaints(0) + _lacking(out)


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


_ALL = (
    MachineFault("machine_home_missing", _home_missing, quick=True),
    MachineFault("machine_home_unset", _home_unset),
    MachineFault("machine_cache_refused", _cache_refused),
    MachineFault("machine_no_compiler", _no_compiler),
    MachineFault("machine_compiler_misspelt", _compiler_misspelt),
    MachineFault("machine_disk_full", _disk_full, quick=True),
    MachineFault("machine_journal_damaged", _journal_damaged),
    MachineFault("machine_output_full", _output_full),
    MachineFault("machine_reader_gone", _reader_gone),
    MachineFault("machine_ascii_only", _ascii_only),
    MachineFault("machine_few_files", _few_files),
    MachineFault("machine_nowhere_to_write", _nowhere_to_write),
    MachineFault("machine_endless_file", _endless_file),
    MachineFault("machine_domain_misspelt", _domain_misspelt),
    MachineFault("machine_two_demos", _two_demos),
    MachineFault("machine_bag_cut_short", _bag_cut_short),
    MachineFault("machine_foreign_page", _foreign_page),
    MachineFault("machine_far_start", _far_start),
)

MACHINE_FAULTS = {fault.name: fault for fault in _ALL}
"""All faults of the machine by name, in the order in which they are tried."""
