"""All readers of what a user can supply, by name."""

from __future__ import annotations

from tests.fuzz import clouds, models, pictures, records, scenes, tables
from tests.fuzz.reader import Reader

READERS: dict[str, Reader] = {
    reader.name: reader for module in (clouds, scenes, tables, pictures, models, records) for reader in module.READERS
}
