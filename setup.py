# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Metadata, which colcon cannot read from a ``[project]`` table, and the build of the solver."""

import os
import platform
import sys
import tempfile
from glob import glob
from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext

NAME = "sphere_nmpc"
SHARED = (
    "config", "config/maps", "examples", "launch", "rviz", "foxglove", "urdf", "msg_docs", "hook",
)
VERBS = (
    "demo", "simulator", "controller", "navigator", "recorder", "goal", "viewer", "markers",
    "study", "benchmark", "report",
)
READING = ["rosbags>=0.11,<0.12", "mcap>=1.2,<2", "ruamel.yaml>=0.18", "zstandard>=0.22"]
"""To read recordings. Of rosbags the type store and the form in which bags hold QoS profiles are
used; its minor versions below 1.0 change interfaces, as 0.11 did those of the reader."""
MAPS = ["pyyaml>=5.4", "pillow>=9"]
"""To read map files."""
EXTRAS = {
    "ros": ["ros-jazzy-rclpy[fastrtps]>=7.1,<8", "ros-jazzy-common-interfaces>=5.3,<6", *MAPS],
    "record": [*READING, "mcap-ros2-support>=0.5,<1"],
    "sim": ["rich>=13", "matplotlib>=3.8,<4", *MAPS],
    "study": ["dask>=2024.8", "distributed>=2024.8"],
    "rigid": ["mujoco>=3.2,<5"],
    "viewer": ["viser>=1.0,<2"],
    "report": [*READING, "matplotlib>=3.8,<4", "pyarrow>=16"],
    # launch_testing's pytest plugin breaks under pytest 9.
    "test": [
        "pytest>=7.4,<9", "pytest-xdist>=3.3", "hypothesis>=6.100", "ruff>=0.9", "mypy>=1.14",
        "packaging",
    ],
}

DEPENDS = [
    "setup.py",
    *sorted(glob("sphere_nmpc/solver/native/*.[ch]") + glob("sphere_nmpc/model/*.py")),
    "sphere_nmpc/solver/native/codegen.py",
    "sphere_nmpc/solver/native/layout.py",
    "sphere_nmpc/solver/problem.py",
]
"""What decides the compiled solver; the Makefile has the same list."""
FLAGS = [
    "-O3", "-std=gnu11", "-ffp-contract=fast", "-fno-math-errno", "-Wno-psabi", "-g0",
    # Undoes the -fwrapv of Python's own options, so that every Python builds the same solver.
    "-fstrict-overflow",
]
LEVELS: dict[str, list[str]] = {"": []}
"""Compiler options by the suffix that ``hold_level`` in solver.c returns for a processor."""
if platform.machine().lower() in ("x86_64", "amd64"):
    LEVELS |= {
        # On Zen 2 and 3 chains of fused operations are slow; tuned for any processor, the code is
        # up to 4 % slower there.
        "_avx2": ["-mavx2", "-mfma", "-mtune=znver2"],
        "_avx512": ["-mavx512f", "-mavx512dq", "-mavx512vl", "-mfma", "-mtune=skylake-avx512"],
    }


class BuildSolver(build_ext):
    """Builds a shared library, loaded by ctypes, for each instruction set.

    Where that is not possible the package is installed all the same: it has a slower solver.
    """

    def run(self) -> None:
        """Build, and copy the libraries into the source tree for an editable installation."""
        try:
            super().run()
        except Exception as cause:
            self.extensions = []
            words = " ".join(str(cause).split())
            print(
                f"sphere_nmpc: the solver is not compiled ({words}); a plain one takes its place, "
                "which takes about 300 times as long. To cure this, install the package again "
                "with a C compiler and CasADi", file=sys.stderr,
            )

    def build_extensions(self) -> None:
        """Generate the kernels, then compile in parallel, each library in a folder of its own."""
        sys.path.insert(0, os.getcwd())
        from sphere_nmpc.solver.native.codegen import kernel_source
        from sphere_nmpc.solver.native.layout import problem_header

        folder = Path(self.build_temp)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "kernels.h").write_text(kernel_source(), encoding="utf-8")
        (folder / "problem.h").write_text(problem_header(), encoding="utf-8")
        self.parallel = True
        super().build_extensions()

    def build_extension(self, ext: Extension) -> None:
        """Compile and link one library, unless one in the build folder is up to date."""
        made = Path(self.get_ext_fullpath(ext.name))
        changed = max(Path(source).stat().st_mtime for source in [*ext.sources, *ext.depends])
        if made.exists() and made.stat().st_mtime > changed:
            return
        objects = self.compiler.compile(
            ext.sources, os.path.join(self.build_temp, ext.name), include_dirs=[self.build_temp],
            extra_postargs=ext.extra_compile_args,
        )
        self.compiler.link_shared_object(objects, str(made), libraries=["m"])

    def get_ext_filename(self, fullname: str) -> str:
        """Return the name of a library, without the tag of a Python version: it serves all."""
        return os.path.join(*fullname.split(".")) + ".so"

    def copy_file(self, infile: str, outfile: str, *args: object, **options: object) -> None:
        """Copy into the source tree such that other processes find the old file or the new one."""
        fresh = f"{outfile}.{os.getpid()}"
        super().copy_file(infile, fresh, *args, **options)
        os.replace(fresh, outfile)


# Not in the source tree: two installations from one tree may run at once.
build_folder = tempfile.TemporaryDirectory()
setup(
    options={"build": {"build_base": build_folder.name}},
    cmdclass={"build_ext": BuildSolver},
    ext_modules=[
        Extension(
            f"sphere_nmpc.solver.native.solver{level}", ["sphere_nmpc/solver/native/solver.c"],
            extra_compile_args=[*FLAGS, *flags], depends=DEPENDS,
        )
        for level, flags in LEVELS.items()
    ],
    name=NAME,
    version="0.1.0",
    description="NMPC of a rolling sphere with two rotors, to any position and orientation",
    long_description=(
        "A ROS 2 Jazzy package with simulator, nonlinear model predictive controller, recorder, "
        "viewer and study tools for a rolling sphere driven by two internal rotors."
    ),
    maintainer="sphere_nmpc maintainers",
    maintainer_email="sphere-nmpc@example.org",
    license="Apache-2.0",
    classifiers=[
        "Programming Language :: Python :: 3",
        "Topic :: Scientific/Engineering",
    ],
    python_requires=">=3.10",
    packages=find_packages(include=[NAME, f"{NAME}.*", "sphere_sim", "sphere_sim.*"]),
    package_data={
        "": ["py.typed", "*.c", "*.h", "*.css", "*.html", "*.js", "*.csv", "*.npz", "*.xml"]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        # Where the hook of a colcon workspace (colcon.pkg) finds it.
        (f"share/{NAME}/bin", [f"hook/{NAME}"]),
        *((f"share/{NAME}/{folder}", sorted(glob(f"{folder}/*.*"))) for folder in SHARED),
    ],
    install_requires=["numpy>=1.26,<3", "scipy>=1.11,<2", "casadi>=3.6.7,<4"],
    extras_require={**EXTRAS, "all": sorted({r for rs in EXTRAS.values() for r in rs})},
    entry_points={
        "console_scripts": [
            "sphere_nmpc = sphere_sim.cli.main:main",
            # Each verb too, for `ros2 run`; the command knows the verb by the name of the script.
            *(f"{verb} = sphere_sim.cli.main:main" for verb in VERBS),
        ]
    },
)
