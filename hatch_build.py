"""Build of the compiled kernels: the wheel's build hook, and `python hatch_build.py` for a checkout.

The compiler is Clang as the package `ziglang` brings it, so that nothing but pip is needed; CXX names another one.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import subprocess
import sys
import sysconfig
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

FOLDER = Path(__file__).parent / "geomosaic" / "kernels"
SUFFIX = {"Windows": ".dll", "Darwin": ".dylib"}.get(platform.system(), ".so")
# No contraction to fused multiply-add and no fast maths: the bytes are the same whatever the vector instructions.
FLAGS = [
    "-std=c++20",
    "-O3",
    "-shared",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-exceptions",
    "-fno-rtti",
    "-fvisibility=hidden",
]
# Ends of names, and what the processor must have: at least what the wheels of NumPy ask for (SSE4.2).
VARIANTS = {"": "x86-64-v2", "-avx2": "x86-64-v3", "-avx512": "x86-64-v4"}


def build() -> list[Path]:
    """Libraries of kernels, compiled beside their sources, one for each set of vector instructions."""
    sources = sorted(FOLDER.glob("*.cpp"))
    on_x86 = platform.machine().lower() in ("x86_64", "amd64")
    compiler = shlex.split(os.environ.get("CXX", ""))
    own = not compiler
    if own:
        # Without the C++ library, and against a C library as old as any that the other packages run on.
        compiler = [sys.executable, "-m", "ziglang", "c++", "-fno-sanitize=undefined", "-nostdlib++", "-s"]
        if platform.system() == "Linux":
            compiler += ["-target", f"{platform.machine()}-linux-gnu.2.17"]
    if platform.system() != "Windows":
        compiler.append("-fPIC")

    def compile_variant(end: str) -> Path:
        target = FOLDER / f"kernels{end}{SUFFIX}"
        level = VARIANTS[end].replace("-", "_") if own else VARIANTS[end]
        instructions = [f"-mcpu={level}" if own else f"-march={level}"] if on_x86 else []
        if end == "-avx512":  # unless asked, compilers use half of each register: a quarter slower
            instructions.append("-mprefer-vector-width=512")
        stamp = f'-DSOURCES="{digest()}"'
        command = [*compiler, *FLAGS, *instructions, stamp, "-o", str(target), *map(str, sources), "-lm"]
        try:
            subprocess.run(command, capture_output=True, text=True, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            said = getattr(error, "stderr", error)
            raise SystemExit(
                f"the kernels cannot be compiled: {shlex.join(command)}\n{said}\nInstall the package with pip, which "
                "brings a compiler (ziglang), or name one that knows C++20 in CXX"
            ) from None
        return target

    with ThreadPoolExecutor() as executor:
        return list(executor.map(compile_variant, VARIANTS if on_x86 else [""]))


def digest() -> str:
    """SHA-256 of the sources, which the library answers with when asked for its own."""
    files = sorted([*FOLDER.glob("*.cpp"), *FOLDER.glob("*.hpp")])
    return hashlib.sha256(b"".join(file.name.encode() + b"\n" + file.read_bytes() for file in files)).hexdigest()


def platform_tag() -> str:
    """Platform that the libraries run on, as wheels name it."""
    if platform.system() == "Linux":
        return f"manylinux_2_17_{platform.machine()}"
    return sysconfig.get_platform().replace("-", "_").replace(".", "_")


try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # `python hatch_build.py` needs the compiler only
    pass
else:

    class KernelsHook(BuildHookInterface):
        """Build hook of wheels and of editable installs."""

        def initialize(self, version: str, build_data: dict[str, object]) -> None:
            """Compile the kernels and put them into the wheel."""
            built = build()
            build_data["pure_python"] = False
            build_data["tag"] = f"py3-none-{platform_tag()}"
            build_data["artifacts"] = [f"/{path.relative_to(Path(self.root)).as_posix()}" for path in built]


if __name__ == "__main__":
    for library in build():
        print(library)
