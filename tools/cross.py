"""Compiles and links the native module for systems that are not this one, with zig (PyPI `ziglang`).

    .venv/bin/python -m pip install ziglang cmake ninja nanobind     # once; then, with any Python from 3.12 on:
    python tools/cross.py aarch64-linux aarch64-macos x86_64-windows

Each goes into build/cross/SYSTEM. zig brings every system's C library, so what it links runs there
from the stated version on; Python's headers are this interpreter's, all under the stable ABI, and
what Windows asks of `python3.dll` is listed from them.
"""

from __future__ import annotations

import argparse
import importlib.util
import re
import shutil
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OLDEST_PYTHON = "3.12"


@dataclass(frozen=True, kw_only=True)
class System:
    """What the module is compiled for."""

    zig_target: str
    """With the oldest C library that it may meet."""
    name: str
    """CMake's name of the system."""
    processor: str
    """CMake's name of the processor."""
    begins_with: bytes
    """The first bytes of a module of this system."""
    machine: tuple[int, bytes]
    """Offset and bytes by which its header names the processor; on Windows past the DOS stub."""


SYSTEMS = {
    "x86_64-linux": System(
        zig_target="x86_64-linux-gnu.2.28", name="Linux", processor="x86_64", begins_with=b"\x7fELF\x02", machine=(18, b"\x3e\x00")
    ),
    "aarch64-linux": System(
        zig_target="aarch64-linux-gnu.2.28", name="Linux", processor="aarch64", begins_with=b"\x7fELF\x02", machine=(18, b"\xb7\x00")
    ),
    "aarch64-macos": System(
        zig_target="aarch64-macos.12.0",
        name="Darwin",
        processor="arm64",
        begins_with=b"\xcf\xfa\xed\xfe",
        machine=(4, b"\x0c\x00\x00\x01"),
    ),
    "x86_64-windows": System(
        zig_target="x86_64-windows-gnu", name="Windows", processor="AMD64", begins_with=b"MZ", machine=(4, b"\x64\x86")
    ),
}

# zig names processors with underscores. CMake asks the Python of this system what it links: libdl, which Windows has not. On macOS
# nanobind lists Python's names for Apple's linker, where zig's takes the one option that means all of them. Python loads a library as well
# as a bundle, which zig 0.17 did not make.
COMPILER = """arguments=()
for one in "$@"; do
  case "$one" in
    -march=x86-64-v*) arguments+=("-march=x86_64_v${{one##*-v}}") ;;
    *darwin-ld-*.sym) arguments+=(-Wl,-undefined,dynamic_lookup) ;;
    -bundle) arguments+=(-dynamiclib) ;;
    -ldl) [[ {target} == *windows* ]] || arguments+=("$one") ;;
    *) arguments+=("$one") ;;
  esac
done
exec {zig} c++ -target {target} "${{arguments[@]}}" """

# Windows keeps its own pyconfig.h with the source of Python; this is what the stable ABI's headers ask of it.
WINDOWS_CONFIG = """#pragma once
#define MS_WINDOWS 1
#define MS_WIN32 1
#define MS_WIN64 1
#define SIZEOF_VOID_P 8
#define SIZEOF_SIZE_T 8
#define SIZEOF_LONG 4
#define SIZEOF_LONG_LONG 8
#define SIZEOF_WCHAR_T 2
#define ALIGNOF_MAX_ALIGN_T 8
#define HAVE_DECLSPEC_DLL 1
#define Py_ENABLE_SHARED 1
#define HAVE_STDINT_H 1
#define HAVE_STDDEF_H 1
#define HAVE_SYS_TYPES_H 1
#define PY_SSIZE_T_MAX LLONG_MAX
"""


def zig() -> str:
    """The command of zig, of the package `ziglang` of this environment."""
    spec = importlib.util.find_spec("ziglang")
    if spec is None or spec.origin is None:
        raise SystemExit(f"zig is missing: {sys.executable} -m pip install ziglang cmake ninja nanobind")
    return str(Path(spec.origin).parent / "zig")


def write_program(path: Path, line: str) -> None:
    """A program for CMake, which takes no command of several words for `ar`."""
    path.write_text(f"#!/bin/bash\n{line}\n")
    path.chmod(0o755)


def write_headers(folder: Path, system: System) -> None:
    """Python's headers, with the configuration of the system they are for."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(sysconfig.get_path("include"), folder)
    if system.name == "Windows":
        (folder / "pyconfig.h").write_text(WINDOWS_CONFIG)
    else:
        # Every 64-bit Unix has these sizes; Debian's own file asks for headers of each processor.
        shutil.copy(sysconfig.get_config_h_filename(), folder / "pyconfig.h")


def write_windows_library(headers: Path, library: Path) -> None:
    """What a linker for Windows asks for: the names that python3.dll exports, as the headers declare them."""
    names = {"functions": set[str](), "data": set[str]()}
    for header in headers.rglob("*.h"):
        text = header.read_text()
        names["functions"] |= set(re.findall(r"PyAPI_FUNC\([^()]*\)\s*(\w+)", text))
        names["data"] |= set(re.findall(r"PyAPI_DATA\([^()]*\)\s*(\w+)", text))
    exports = sorted(names["functions"]) + [f"{name} DATA" for name in sorted(names["data"])]
    definition = library.with_suffix(".def")
    definition.write_text("\n".join(["LIBRARY python3.dll", "EXPORTS", *exports, ""]))
    subprocess.run([zig(), "dlltool", "-m", "i386:x86-64", "-D", "python3.dll", "-d", definition, "-l", library], check=True)


def configuration(folder: Path, system: System) -> list[str]:
    """CMake's settings; writes the programs, headers and libraries that they name."""
    headers = folder / "python"
    folder.mkdir(parents=True, exist_ok=True)
    write_headers(headers, system)
    write_program(folder / "c++", COMPILER.format(zig=zig(), target=system.zig_target))
    for tool in ("ar", "ranlib"):
        write_program(folder / tool, f'exec {zig()} {tool} "$@"')
    settings = {
        "CMAKE_BUILD_TYPE": "Release",
        "CMAKE_CROSSCOMPILING_EMULATOR": "/usr/bin/env",  # for Python, which runs here as it is
        "CMAKE_SYSTEM_NAME": system.name,
        "CMAKE_SYSTEM_PROCESSOR": system.processor,
        "CMAKE_CXX_COMPILER": folder / "c++",
        "CMAKE_AR": folder / "ar",
        "CMAKE_RANLIB": folder / "ranlib",
        "CMAKE_INSTALL_NAME_TOOL": "/usr/bin/false",  # asked for when CMake looks at macOS; nothing is installed
        "CMAKE_LIBRARY_OUTPUT_DIRECTORY": folder / "out",
        "CMAKE_RUNTIME_OUTPUT_DIRECTORY": folder / "out",
        "Python_EXECUTABLE": sys.executable,
        "Python_INCLUDE_DIR": headers,
        "SKBUILD_STATE": "editable",
        "SKBUILD_SABI_COMPONENT": "Development.SABIModule",
        "SKBUILD_SABI_VERSION": OLDEST_PYTHON,
        "SKBUILD_SOSABI": "" if system.name == "Windows" else "abi3",
        "nanobind_DIR": subprocess.check_output([sys.executable, "-m", "nanobind", "--cmake_dir"], text=True).strip(),
    }
    if system.name == "Windows":
        write_windows_library(headers, folder / "python3.lib")
        # CMake reads the version in this name, and links only the stable one.
        versioned = shutil.copy(folder / "python3.lib", folder / f"python{sys.version_info.major}{sys.version_info.minor}.lib")
        settings |= {"Python_LIBRARY": versioned, "Python_SABI_LIBRARY": folder / "python3.lib"}
    return [f"-D{key}={value}" for key, value in settings.items()]


def check(module: Path, system: System) -> None:
    """The header says that the module is for this system and processor."""
    start = module.read_bytes()[:4096]
    offset = int.from_bytes(start[60:64], "little") if system.name == "Windows" else 0
    at, expected = system.machine
    number = start[offset + at : offset + at + len(expected)]
    if not start.startswith(system.begins_with) or number != expected:
        raise SystemExit(f"{module} is not of {system.zig_target}: it begins with {start[:5].hex()} and names processor {number.hex()}.")


def build(system: System, folder: Path) -> Path:
    """The module of one system."""
    subprocess.run(["cmake", "-G", "Ninja", "-S", ROOT, "-B", folder / "cmake", *configuration(folder, system)], check=True)
    subprocess.run(["cmake", "--build", folder / "cmake"], check=True)
    (module,) = [path for path in (folder / "out").iterdir() if path.suffix in (".so", ".pyd")]
    check(module, system)
    return module


def main() -> None:
    """What was built, a line each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("systems", nargs="*", choices=[*SYSTEMS, []], help=f"of {', '.join(SYSTEMS)}; all of them by default")
    parser.add_argument("--into", type=Path, default=ROOT / "build" / "cross")
    options = parser.parse_args()
    modules = {name: build(SYSTEMS[name], (options.into / name).resolve()) for name in options.systems or SYSTEMS}
    for name, module in modules.items():
        print(f"{name}: {module} for {SYSTEMS[name].zig_target}, {module.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
