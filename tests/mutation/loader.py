"""Imports one module from broken source; nothing on the disk is touched."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType


class _BrokenLoader(SourceFileLoader):
    def __init__(self, name: str, path: str, source: str) -> None:
        super().__init__(name, path)
        self._source = source

    def get_code(self, fullname: str) -> CodeType:
        """Compile the broken source; caches of the sound one are not asked."""
        code: CodeType = compile(self._source, self.path, "exec", dont_inherit=True)
        return code


class BrokenModule(MetaPathFinder):
    """Finds the module of ``path`` below ``root`` as ``source`` instead of what the file holds."""

    def __init__(self, root: Path, path: str, source: str) -> None:
        self.name = path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
        self._path = str(root / path)
        self._source = source

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The broken module's, and nobody else's."""
        if fullname != self.name:
            return None
        loader = _BrokenLoader(fullname, self._path, self._source)
        return importlib.util.spec_from_file_location(fullname, self._path, loader=loader)

    def install(self) -> None:
        """Put it before all finders. The module must not have been imported yet."""
        if self.name in sys.modules:
            msg = f"{self.name} is imported already"
            raise RuntimeError(msg)
        sys.meta_path.insert(0, self)
