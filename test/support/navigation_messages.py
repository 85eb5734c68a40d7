# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Package nav2_msgs with types of the navigator's clients, built where Nav2 is not installed.

The generators, headers and libraries in the ROS wheels make it from the table of fields below,
with gcc and g++, in about 25 s. It is built once a machine, interpreter and version of this file.
"""

import fcntl
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path

PACKAGE = "nav2_msgs"
JAZZY = metadata.version("rclpy").startswith("7.")
"""Whether the types are those of Jazzy, otherwise those of Kilted."""
MISSED = ("index", "goal") if JAZZY else ("waypoint_index", "waypoint_pose")
"""Names of fields of a waypoint that was missed."""
_RESULT = ("uint16 error_code", "string error_msg")
_UNKNOWN = () if JAZZY else ("uint16 UNKNOWN=9000",)
_STATUSES = () if JAZZY else (f"{PACKAGE}/WaypointStatus[] waypoint_statuses",)
_FEEDBACK = (
    "geometry_msgs/PoseStamped current_pose", "builtin_interfaces/Duration navigation_time",
    "builtin_interfaces/Duration estimated_time_remaining", "int16 number_of_recoveries",
    "float32 distance_remaining",
)
FIELDS: dict[str, tuple[tuple[str, ...], ...]] = {
    "NavigateToPose.action": (
        ("geometry_msgs/PoseStamped pose", "string behavior_tree"), (*_UNKNOWN, *_RESULT),
        _FEEDBACK,
    ),
    "NavigateThroughPoses.action": (
        ("geometry_msgs/PoseStamped[] poses" if JAZZY else "nav_msgs/Goals poses",
         "string behavior_tree"),
        (*_UNKNOWN, *_RESULT, *_STATUSES),
        (*_FEEDBACK, "int16 number_of_poses_remaining", *_STATUSES),
    ),
    "FollowWaypoints.action": (
        ("uint32 number_of_loops", "uint32 goal_index 0", "geometry_msgs/PoseStamped[] poses"),
        ("uint16 NONE=0", "uint16 UNKNOWN=600", *_RESULT,
         f"{PACKAGE}/{'MissedWaypoint' if JAZZY else 'WaypointStatus'}[] missed_waypoints"),
        ("uint32 current_waypoint",),
    ),
    "FollowPath.action": (
        ("nav_msgs/Path path", "string controller_id", "string goal_checker_id"),
        ("uint16 NONE=0", "uint16 UNKNOWN=100", "uint16 INVALID_PATH=103",
         "std_msgs/Empty result", *_RESULT),
        ("float32 distance_to_goal", "float32 speed"),
    ),
    "ComputePathToPose.action": (
        ("geometry_msgs/PoseStamped goal", "geometry_msgs/PoseStamped start", "string planner_id",
         "bool use_start"),
        ("nav_msgs/Path path", "builtin_interfaces/Duration planning_time", *_RESULT), (),
    ),
    "Spin.action": (
        ("float32 target_yaw", "builtin_interfaces/Duration time_allowance"),
        ("builtin_interfaces/Duration total_elapsed_time", *_RESULT),
        ("float32 angular_distance_traveled",),
    ),
    "ClearEntireCostmap.srv": (("std_msgs/Empty request",), ("std_msgs/Empty response",)),
    "GetCostmap.srv": ((f"{PACKAGE}/CostmapMetaData specs",), (f"{PACKAGE}/Costmap map",)),
    "LoadMap.srv": (
        ("string map_url",),
        ("uint8 RESULT_SUCCESS=0", "uint8 RESULT_UNDEFINED_FAILURE=255",
         "nav_msgs/OccupancyGrid map", "uint8 result"),
    ),
    **({"MissedWaypoint.msg": (
        ("uint32 index", "geometry_msgs/PoseStamped goal", "uint16 error_code"),
    )} if JAZZY else {"WaypointStatus.msg": (
        ("uint8 PENDING=0", "uint8 COMPLETED=1", "uint8 FAILED=3", "uint8 waypoint_status",
         "uint32 waypoint_index", "geometry_msgs/PoseStamped waypoint_pose", *_RESULT),
    )}),
    "Costmap.msg": (
        ("std_msgs/Header header", f"{PACKAGE}/CostmapMetaData metadata", "uint8[] data"),
    ),
    "CostmapMetaData.msg": (
        ("builtin_interfaces/Time map_load_time", "builtin_interfaces/Time update_time",
         "string layer", "float32 resolution", "uint32 size_x", "uint32 size_y",
         "geometry_msgs/Pose origin"),
    ),
}
"""Fields of each part of the types, which are some of those of nav2_msgs."""
_USED = (
    "builtin_interfaces", "unique_identifier_msgs", "service_msgs", "std_msgs", "geometry_msgs",
    "nav_msgs", "action_msgs",
)
"""Packages whose messages are part of the types, and of actions."""
_BUILT = "built"
_KINDS = ("action", "msg", "srv")
_TYPES_C, _TYPES_PY = "rosidl_generator_c", "rosidl_generator_py"
_INTROSPECTION, _FASTRTPS = "rosidl_typesupport_introspection_c", "rosidl_typesupport_fastrtps_c"
_DISPATCH = "rosidl_typesupport_c"
_LIBRARIES = (_TYPES_C, _INTROSPECTION, _FASTRTPS, _DISPATCH)
"""Generators whose output is a library, in the order in which they are loaded."""
_INIT = f"""import ctypes
from pathlib import Path

# The libraries find each other by the names of those that are loaded.
for name in {_LIBRARIES}:
    ctypes.CDLL(Path(__file__).with_name("lib{PACKAGE}__" + name + ".so"), ctypes.RTLD_GLOBAL)
"""


def provide() -> None:
    """Make nav2_msgs importable, here and in nodes that are started, unless it is installed.

    A test is skipped where something is missing to build it.
    """
    if importlib.util.find_spec(PACKAGE) is None:
        if missing := lacking():
            import pytest

            pytest.skip(f"{PACKAGE} is not installed, and to build it {missing} is missing")
        sys.path.append(str(built()))


def lacking() -> str:
    """Return what is missing to build the package, empty where nothing is."""
    files = {
        "the wheel of rosidl_generator_py": Path(sys.prefix, "share", _TYPES_PY),
        "Python.h": Path(sysconfig.get_path("include"), "Python.h"),
    }
    missing = [program for program in ("gcc", "g++") if shutil.which(program) is None]
    return ", ".join(missing + [name for name, path in files.items() if not path.exists()])


def built() -> Path:
    """Return the folder that holds the package; one process builds it, while others wait."""
    from sphere_nmpc.foreign.own_folder import own_folder

    decisive = [Path(__file__).read_bytes(), sys.version.encode(), sys.prefix.encode()]
    digest = hashlib.sha256(b"\n".join(decisive)).hexdigest()[:16]
    shared = own_folder(Path(tempfile.gettempdir(), f"sphere_nmpc-{os.getuid()}"))
    folder = shared / f"{PACKAGE}_{digest}"
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            with tempfile.TemporaryDirectory(dir=folder.parent) as work:
                # In a process of its own, as the generators replace the standard output.
                prefix = {"AMENT_PREFIX_PATH": sys.prefix}
                _run(sys.executable, __file__, work, environment=os.environ | prefix)
                os.replace(Path(work, _BUILT), folder)
    return folder


def _build(work: Path) -> None:
    """Generate and compile the package in an empty folder."""
    _generate(work)
    package = work / _BUILT / PACKAGE
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(_INIT)
    python_types = work / _TYPES_PY / PACKAGE
    for kind in _KINDS:
        (package / kind).mkdir()
        for module in python_types.glob(f"{kind}/*.py"):
            module.rename(package / kind / module.name)
    units = [unit for kind in (*_LIBRARIES, _TYPES_PY) for unit in (work / kind).rglob("*.c*")]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        objects = list(pool.map(lambda unit: _compile(unit, work), units))
    for kind in (*_LIBRARIES, _TYPES_PY):
        own = [made for made in objects if made.is_relative_to(work / kind)]
        library = f"lib{PACKAGE}__{kind}.so"
        if kind == _TYPES_PY:
            library = f"{PACKAGE}_s__{_DISPATCH}.so"
        _link(own, package / library, kind)


def _generate(work: Path) -> None:
    from ament_index_python import get_package_share_directory
    from rosidl_adapter import convert_to_idl
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    include = [get_package_share_directory(package) for package in _USED]
    source = work / "source"
    for kind in _KINDS:
        (source / kind).mkdir(parents=True)
    descriptions = []
    for name, parts in FIELDS.items():
        interface = Path(Path(name).suffix[1:], name)
        text = "\n---\n".join("\n".join(fields) for fields in parts)
        (source / interface).write_text(text + "\n")
        convert_to_idl(source, PACKAGE, interface, source)
        descriptions.append(f"{source}:{interface.with_suffix('.idl')}")
    hashes = HashTypeDescription("hash").generate_type_hashes(
        PACKAGE, descriptions, include, work / "hashes"
    )
    of_hashes = {"type_description_files": hashes}
    supports = [_FASTRTPS, _INTROSPECTION]
    generators = {
        _TYPES_C: (GenerateC("c"), of_hashes),
        _INTROSPECTION: (GenerateIntrospectionCTypesupport("introspection"), {}),
        _FASTRTPS: (GenerateFastRTPSCTypesupport("fastrtps"), {}),
        _DISPATCH: (GenerateCTypesupport("dispatch", typesupport_implementations=supports), {}),
        _TYPES_PY: (GeneratePython("py", typesupport_implementations=[_DISPATCH]), {}),
    }
    for kind, (generator, more) in generators.items():
        generator.generate(PACKAGE, descriptions, include, work / kind / PACKAGE, **more)


def _compile(unit: Path, work: Path) -> Path:
    import numpy

    headers = Path(sys.prefix, "include")
    folders = [
        *(work / kind for kind in _LIBRARIES), *(path for path in headers.iterdir()), headers,
        sysconfig.get_path("include"), numpy.get_include(),
    ]
    compiler = ("gcc", "-std=gnu11") if unit.suffix == ".c" else ("g++", "-std=c++17")
    compiled = unit.with_name(f"{unit.name}.o")
    _run(
        *compiler, "-O0", "-fPIC", "-w", *(f"-I{folder}" for folder in folders),
        "-c", str(unit), "-o", str(compiled),
    )
    return compiled


def _link(objects: list[Path], library: Path, kind: str) -> None:
    """Link a library with those of the same kind of other packages; the own ones are loaded."""
    folder = Path(sys.prefix, "lib")
    names = [f"{package}__{kind}" for package in _USED] + [kind, "rosidl_runtime_c", "rcutils"]
    found = [name for name in names if (folder / f"lib{name}.so").exists()]
    _run(
        "g++", "-shared", "-o", str(library), *map(str, objects), f"-Wl,-soname,{library.name}",
        f"-L{folder}", f"-Wl,-rpath,{folder},--unresolved-symbols=ignore-all,-z,lazy",
        *(f"-l{name}" for name in found),
    )


def _run(*command: str, environment: dict[str, str] | None = None) -> None:
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=environment
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}\n{done.stderr}")


if __name__ == "__main__":
    _build(Path(sys.argv[1]).resolve())
