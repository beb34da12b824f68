"""Data sets from 10^2 to 10^6 trajectories, batches over devices and processes, and the disk: what grows with what."""

import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from experiments.benchmarks.harness import ROOT, Table, at_most, in_subprocess, report

ROWS = 512


def run(quick: bool) -> None:
    """Measure; six minutes, of which the million takes most."""
    counts = [10**power for power in range(2, 6 if quick else 7)]
    with tempfile.TemporaryDirectory(dir=ROOT) as folder:
        disk = in_subprocess("scale_part", "disk", folder)
        sizes = []
        for count in counts:
            place = Path(folder) / str(count)
            place.mkdir()
            sizes.append({"count": count, **in_subprocess("scale_part", "store", str(count), str(place))})
            shutil.rmtree(place)
    meshes = [{"processes": 1, **_on_devices(devices)} for devices in (1, 2, 4, 8)]
    meshes += [{"processes": 2, **_on_processes(devices)} for devices in (1, 2)]
    tables = [_table_of_sizes(sizes), _table_of_disk(disk), _table_of_meshes(meshes), _table_on_paper(sizes[-1], disk)]
    report("scale", tables, {"sizes": sizes, "disk": disk, "meshes": meshes})


def _table_of_sizes(sizes: list[dict[str, Any]]) -> Table:
    rows = []
    for found in sizes:
        each = found["seconds"] / found["count"]
        rows.append((found["count"], found["seconds"], 1e6 * each, found["more_memory"] / 1e6, found["size"] / found["count"]))
    large = [row for row in rows if row[0] >= 10_000]
    spread = max(row[2] for row in large) / min(row[2] for row in large)
    rows.append(("10^4 and more: greatest over least", "", at_most(spread, 1.25), "", ""))
    headers = ("trajectories", "seconds", "us a trajectory", "memory more than for 256, MB", "bytes a trajectory")
    return Table(
        "Data sets: seven joints, 1 s, adaptive, 11 times saved, float64, randomised links; compiled before", headers, rows
    )


def _table_of_disk(disk: dict[str, Any]) -> Table:
    rows = [("chunks of a store", disk["store"] / 1e6), ("plain files of as many bytes", disk["plain"] / 1e6)]
    rows.append(("share", disk["store"] / disk["plain"]))
    return Table("Writing, waiting for the disk after each chunk", ("", "MB/s"), rows)


def _table_of_meshes(meshes: list[dict[str, Any]]) -> Table:
    one = meshes[0]["seconds"]
    rows = []
    for found in meshes:
        times = found["devices"] * one / found["seconds"]
        rows.append((found["processes"], found["devices"], ROWS * found["devices"], found["seconds"], times))
    headers = ("processes", "virtual devices, all", "trajectories", "seconds", "trajectories a second, times one device")
    return Table(f"Weak scaling on this machine's cores: {ROWS} trajectories a device, 100 equal steps, one program", headers, rows)


def _table_on_paper(largest: dict[str, Any], disk: dict[str, Any]) -> Table:
    total = 1_000_000_000
    hours = total * largest["seconds"] / largest["count"] / 3600
    size = total * largest["size"] / largest["count"]
    writing = size / disk["store"] / 3600
    rows = [
        ("bytes", f"{size / 1e12:.3g} TB"),
        ("files", f"{total / 1024 * 8:.3g}"),
        ("hours on this machine", hours),
        ("hours of writing at its disk's speed", writing),
        ("such machines for a day", hours / 24),
    ]
    return Table("10^9 trajectories, on paper from the largest measured", ("", ""), rows)


def _on_devices(devices: int) -> dict[str, Any]:
    flags = f"--xla_force_host_platform_device_count={devices}"
    return in_subprocess("scale_part", "mesh", str(ROWS), "1", "0", "0", XLA_FLAGS=flags)


def _on_processes(devices: int) -> dict[str, Any]:
    """Two processes with so many devices each."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "experiments.benchmarks.scale_part", "mesh", str(ROWS), "2"]
    environment = os.environ | {"XLA_FLAGS": f"--xla_force_host_platform_device_count={devices}"}
    second = subprocess.Popen([*command, "1", str(port)], cwd=ROOT, env=environment, stdout=subprocess.PIPE)
    first = subprocess.run([*command, "0", str(port)], cwd=ROOT, env=environment, stdout=subprocess.PIPE, check=True)
    second.communicate(timeout=120)
    return json.loads(first.stdout.splitlines()[-1])
