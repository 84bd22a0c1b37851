"""Build hook: compiles the kernels into the package (checkouts) or the wheel; never stops an installation.

A checkout gets one library for this machine.  A wheel gets one for each processor variant and the platform's tag; one
without a library is tagged ``any``.  ``LMKIT_BUILD_KERNELS`` is ``none`` for a wheel without, or a name from
``TARGETS`` in ``lmkit/kernels/build.py`` to build for another platform with ``ziglang``.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SWITCH = "LMKIT_BUILD_KERNELS"


class KernelsHook(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the compiled kernels."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """``ziglang`` where no compiler works, or where another platform is built for."""
        wanted = os.environ.get(SWITCH, "")
        try:
            build = self._build()
            needed = bool(wanted) or build.needs_ziglang()
        except Exception:
            return []
        return [build.ZIGLANG] if needed and wanted != "none" else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and add what was compiled to the wheel."""
        wanted = os.environ.get(SWITCH, "")
        if wanted == "none":
            return
        try:
            build = self._build()
            if version == "editable":
                build.build_native()
            else:
                self._add_variants(build, build.TARGETS[wanted] if wanted else build.this_target(), build_data)
        except Exception as error:
            if wanted:
                raise
            self.app.display_warning(f"lmkit is installed without compiled kernels: {error}")
            if version != "editable":
                self._add_reason(str(error), build_data)

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the temporary libraries."""
        if hasattr(self, "_temporary"):
            self._temporary.cleanup()

    def _build(self) -> ModuleType:
        path = Path(self.root) / "lmkit" / "kernels" / "build.py"
        spec = importlib.util.spec_from_file_location("lmkit_kernels_build", path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module  # dataclasses look their module up
        spec.loader.exec_module(module)
        return module

    def _folder(self) -> Path:
        self._temporary = tempfile.TemporaryDirectory(prefix="lmkit-wheel-")
        return Path(self._temporary.name)

    def _add_variants(self, build: ModuleType, target: Any, build_data: dict[str, Any]) -> None:
        for path in build.build_variants(self._folder(), target):
            build_data["force_include"][str(path)] = f"lmkit/kernels/{path.name}"
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{target.wheel_tag or this_platform()}"

    def _add_reason(self, reason: str, build_data: dict[str, Any]) -> None:
        path = self._folder() / self._build().LOG
        path.write_text(f"{reason}\n", encoding="utf-8")
        build_data["force_include"][str(path)] = f"lmkit/kernels/{path.name}"


def this_platform() -> str:
    """The wheel tag of what the system's compiler builds; manylinux would promise an older C library."""
    from packaging.tags import sys_tags

    wider = ("manylinux", "musllinux", "universal", "fat", "intel")
    return next(tag.platform for tag in sys_tags() if not any(word in tag.platform for word in wider))
