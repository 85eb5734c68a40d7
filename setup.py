# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Metadata, which colcon cannot read from a ``[project]`` table, and the build of the solver.

Name, version, description, maintainers and addresses are those of ``package.xml``.
"""

import os
import shlex
import shutil
import subprocess
import sysconfig
import tempfile
from glob import glob
from pathlib import Path
from xml.etree import ElementTree

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).resolve().parent
"""The source tree; `colcon build --symlink-install` works in a folder of links."""
PACKAGE = ElementTree.parse(ROOT / "package.xml").getroot()
NAME, MAINTAINERS = PACKAGE.findtext("name"), PACKAGE.findall("maintainer")
SHARED = (
    "config", "config/maps", "examples", "launch", "rviz", "foxglove", "urdf", "msg_docs", "hook",
)
READING = [
    "rosbags>=0.11,<0.12", "mcap>=1.2,<2", "ruamel.yaml>=0.18", "pyyaml>=5.4", "zstandard>=0.22",
    "lz4>=4",
]
"""To read recordings. Of rosbags the type store and the form in which bags hold QoS profiles are
used; its minor versions below 1.0 change interfaces, as 0.11 did those of the reader."""
SCIPY = "scipy>=1.11,<2"
MAPS = ["pyyaml>=5.4", "pillow>=9", SCIPY]
"""To read map files, and for distances on maps."""
# There are no wheels of ROS for other machines: there it comes from an installation of ROS.
ROS = "ros-{0}-rclpy[fastrtps]{1}; platform_machine == 'x86_64'", (
    "ros-{0}-common-interfaces{2}; platform_machine == 'x86_64'"
)
EXTRAS = {
    "ros": [*(wheel.format("jazzy", ">=7.1,<8", ">=5.3,<6") for wheel in ROS), *MAPS],
    "record": [*READING, "mcap-ros2-support>=0.5,<1"],
    "sim": ["rich>=13", "matplotlib>=3.8,<4", *MAPS],
    "study": ["dask>=2024.8", "distributed>=2024.8"],
    "rigid": ["mujoco>=3.2,<5"],
    "viewer": ["viser>=1.0,<2"],
    "report": [*READING, "matplotlib>=3.8,<4", SCIPY],
    # Also for the plain solver, where the compiled one cannot be used.
    "benchmark": ["casadi>=3.6.7,<4", SCIPY],
    # launch_testing's pytest plugin breaks under pytest 9.
    "test": [
        "pytest>=7.4,<9", "pytest-xdist>=3.3", "hypothesis>=6.100", "ruff>=0.9", "mypy>=1.14",
        "packaging", "gymnasium>=1.0,<2",
    ],
}

SOURCE = "sphere_nmpc/solver/native/solver.c"
FLAGS = [
    "-O3", "-std=gnu11", "-ffp-contract=fast", "-fno-math-errno", "-Wno-psabi", "-fPIC", "-shared",
]
LEVELS: dict[str, list[str]] = {"": []}
"""Compiler options by the suffix that ``hold_level`` in solver.c returns for a processor."""
# That of the machine that is built for, which a cross build has in _PYTHON_HOST_PLATFORM.
if sysconfig.get_platform().endswith(("x86_64", "amd64")):
    LEVELS |= {
        # On Zen 2 and 3 chains of fused operations are slow; tuned for any processor, the code is
        # up to 4 % slower there.
        "_avx2": ["-mavx2", "-mfma", "-mtune=znver2"],
        "_avx512": ["-mavx512f", "-mavx512dq", "-mavx512vl", "-mfma", "-mtune=skylake-avx512"],
    }
IS_PLAIN = os.environ.get("SPHERE_NMPC_SOLVER") == "plain"


class BuildSolver(build_ext):
    """Compiles a shared library, loaded by ctypes, for each instruction set.

    The compiler is CC, or the one of the system; not that of Python's own build, so that every
    Python has the same solver.
    """

    def run(self) -> None:
        """Build, and copy the libraries into the source tree for an editable installation."""
        self.parallel = True
        try:
            super().run()
        except (OSError, subprocess.CalledProcessError) as cause:
            printed = getattr(cause, "stderr", None) or str(cause)
            raise SystemExit(
                f"{NAME}: the solver cannot be compiled, which takes a C compiler, GCC or Clang "
                f"(on Debian and Ubuntu: apt install gcc libc6-dev); SPHERE_NMPC_SOLVER=plain "
                f"installs without it, with a solver that takes 300 times as long and needs "
                f"CasADi:\n{printed}"
            ) from cause

    def build_extension(self, ext: Extension) -> None:
        """Compile one library, unless one in the build folder is up to date."""
        made = Path(self.get_ext_fullpath(ext.name))
        changed = max(Path(source).stat().st_mtime for source in [*ext.sources, *ext.depends])
        if made.exists() and made.stat().st_mtime > changed:
            return
        made.parent.mkdir(parents=True, exist_ok=True)
        found = next(filter(shutil.which, ("cc", "gcc", "clang")), "cc")
        compiler = shlex.split(os.environ.get("CC") or found)
        given = [shlex.split(os.environ.get(name, "")) for name in ("CFLAGS", "LDFLAGS")]
        command = [*compiler, *given[0], *FLAGS, *ext.extra_compile_args, *ext.sources, *given[1]]
        subprocess.run(
            [*command, "-o", made, "-lm"], check=True, stderr=subprocess.PIPE, text=True
        )

    def get_ext_filename(self, fullname: str) -> str:
        """Return the name of a library, without the tag of a Python version: it serves all."""
        return os.path.join(*fullname.split(".")) + ".so"

    def copy_file(self, infile: str, outfile: str, *args: object, **options: object) -> None:
        """Copy into the source tree such that other processes find the old file or the new one."""
        fresh = f"{outfile}.{os.getpid()}"
        super().copy_file(infile, fresh, *args, **options)
        os.replace(fresh, outfile)


COMMANDS = {"build_ext": BuildSolver}
try:
    from setuptools.command.bdist_wheel import bdist_wheel
except ImportError:
    pass  # setuptools before 70.1: colcon on Ubuntu 24.04, which builds no wheels
else:

    class Wheel(bdist_wheel):
        """Wheel for every Python 3 of a platform: the libraries do not use Python's interface."""

        def get_tag(self) -> tuple[str, str, str]:
            """Return the tags of Python, its binary interface and the platform."""
            return "py3", "none", super().get_tag()[2]

    COMMANDS["bdist_wheel"] = Wheel

# Not in the source tree: two installations from one tree may run at once.
build_folder = tempfile.TemporaryDirectory()
setup(
    options={"build": {"build_base": build_folder.name}},
    cmdclass=COMMANDS,
    ext_modules=[] if IS_PLAIN else [
        Extension(
            f"sphere_nmpc.solver.native.solver{level}", [SOURCE], extra_compile_args=flags,
            depends=["setup.py", *glob("sphere_nmpc/solver/native/*.h"),
                     *glob("sphere_nmpc/solver/native/*.inc")],
        )
        for level, flags in LEVELS.items()
    ],
    name=NAME,
    version=PACKAGE.findtext("version"),
    description=PACKAGE.findtext("description"),
    long_description=(ROOT / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    author=PACKAGE.findtext("author"),
    maintainer=", ".join(person.text for person in MAINTAINERS),
    maintainer_email=", ".join(person.attrib["email"] for person in MAINTAINERS),
    url=PACKAGE.findtext("url[@type='website']"),
    project_urls={
        url.attrib["type"].capitalize(): url.text for url in PACKAGE.findall("url")
    },
    license=PACKAGE.findtext("license"),
    license_files=["LICENSE"],
    keywords=["model predictive control", "nonholonomic", "spherical robot", "ROS 2"],
    classifiers=[
        "Development Status :: 4 - Beta",
        "Environment :: Console",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: C",
        "Programming Language :: Python :: 3",
        *(f"Programming Language :: Python :: 3.{minor}" for minor in range(10, 15)),
        "Topic :: Scientific/Engineering",
        "Typing :: Typed",
    ],
    python_requires=">=3.10",
    packages=find_packages(include=[NAME, f"{NAME}.*", "sphere_sim", "sphere_sim.*"]),
    package_data={
        "": ["py.typed", "*.pyi", "*.css", "*.html", "*.js", "*.csv", "*.xml"],
        "sphere_sim": ["suites/*/*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        # What `ros2 run` starts.
        (f"lib/{NAME}", sorted(glob("scripts/*"))),
        # Where the hook of a colcon workspace (colcon.pkg) finds it.
        (f"share/{NAME}/bin", [f"hook/{NAME}"]),
        *((f"share/{NAME}/{folder}", sorted(glob(f"{folder}/*.*"))) for folder in SHARED),
    ],
    install_requires=["numpy>=1.26,<3"],
    extras_require={
        **EXTRAS, "all": sorted({r for rs in EXTRAS.values() for r in rs}),
        # In the place of `ros`.
        "ros-kilted": [*(wheel.format("kilted", ">=9.1,<10", ">=5.5,<6") for wheel in ROS), *MAPS],
    },
    entry_points={"console_scripts": [f"{NAME} = sphere_sim.cli.main:main"]},
)
