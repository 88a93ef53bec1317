"""Stem maps for a GIS: GeoPackage always, GeoJSON only where the cloud's coordinates can be told in WGS84.

GeoJSON knows no other frame (RFC 7946, section 4), so local metres never go into one. A GeoPackage (OGC 12-128r19) is
an SQLite file, which the standard library writes.
"""

from __future__ import annotations

import json
import sqlite3
import struct
from collections.abc import Sequence
from contextlib import closing
from dataclasses import fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.crs import WGS84, to_wgs84
from fsinfer.io.files import atomic_path, write_text
from fsinfer.trees.outputs.table import COLUMNS
from fsinfer.trees.tree import Tree

#: Names of the files.
GEOPACKAGE, GEOJSON = "trees.gpkg", "trees.geojson"
#: Digits of a degree: 0.1 mm on the ground. Source: numerics.
_DEGREE_DIGITS = 9
#: "GPKG", version 1.3, and the "undefined Cartesian" frame of local metres. Source: format; OGC 12-128r19.
_APPLICATION_ID, _VERSION, _LOCAL = 0x47504B47, 10300, -1
_SYSTEMS = """CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER PRIMARY KEY,
organization TEXT NOT NULL, organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT)"""
_CONTENTS = """CREATE TABLE gpkg_contents (table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL,
identifier TEXT UNIQUE, description TEXT DEFAULT '',
last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER,
CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id))"""
_COLUMNS = """CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL, column_name TEXT NOT NULL,
geometry_type_name TEXT NOT NULL, srs_id INTEGER NOT NULL, z TINYINT NOT NULL, m TINYINT NOT NULL,
CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name),
CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES gpkg_contents(table_name),
CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id))"""
_GEODETIC = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],'
    'UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]]'
)


def write_maps(out: Path, trees: Sequence[Tree], *, epsg: int | None = None) -> list[Path]:
    """Write ``trees.gpkg``, and ``trees.geojson`` where the frame can be told in WGS84; returns the paths.

    ``epsg`` is the code of the cloud's horizontal frame, None for local metres. A GeoJSON of an earlier run goes.
    """
    paths = [out / GEOPACKAGE]
    write_geopackage(paths[0], trees, epsg=epsg)
    geojson = out / GEOJSON
    positions = to_wgs84(np.array([(tree.x_m, tree.y_m) for tree in trees]).reshape(-1, 2), epsg)
    if positions is not None:
        write_geojson(geojson, trees, positions)
        paths.append(geojson)
    else:
        geojson.unlink(missing_ok=True)
    return paths


def write_geopackage(path: Path, trees: Sequence[Tree], *, epsg: int | None = None) -> None:
    """Write a layer ``trees`` of points with every column of ``trees.csv``."""
    kinds = [_sql_kind(str(field.type)) for field in fields(Tree)]
    srs = _LOCAL if epsg is None else epsg
    with atomic_path(path) as temporary:
        temporary.unlink(missing_ok=True)
        with closing(sqlite3.connect(temporary)) as base, base:
            base.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
            base.execute(f"PRAGMA user_version = {_VERSION}")
            for table in (_SYSTEMS, _CONTENTS, _COLUMNS):
                base.execute(table)
            systems = [
                ("Undefined Cartesian SRS", -1, "NONE", -1, "undefined", "local metres"),
                ("Undefined geographic SRS", 0, "NONE", 0, "undefined", None),
                ("WGS 84 geodetic", WGS84, "EPSG", WGS84, _GEODETIC, None),
            ]
            if srs not in (-1, 0, WGS84):
                # The definition by its code: programs look EPSG codes up in their own tables.
                systems.append((f"EPSG:{srs}", srs, "EPSG", srs, "undefined", None))
            base.executemany("INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, ?)", systems)
            columns = ", ".join(f"{name} {kind}" for name, kind in zip(COLUMNS, kinds, strict=True))
            base.execute(f"CREATE TABLE trees (fid INTEGER PRIMARY KEY AUTOINCREMENT, geom POINT, {columns})")
            box = [f(v) for f in (min, max) for v in zip(*((t.x_m, t.y_m) for t in trees), strict=True)] or [None] * 4
            base.execute(
                "INSERT INTO gpkg_contents (table_name, data_type, identifier, min_x, min_y, max_x, max_y, srs_id) "
                "VALUES ('trees', 'features', 'trees', ?, ?, ?, ?, ?)",
                (*box, srs),
            )
            base.execute("INSERT INTO gpkg_geometry_columns VALUES ('trees', 'geom', 'POINT', ?, 0, 0)", (srs,))
            marks = ", ".join("?" for _ in range(len(COLUMNS) + 1))
            base.executemany(
                f"INSERT INTO trees (geom, {', '.join(COLUMNS)}) VALUES ({marks})",
                [(_point(tree.x_m, tree.y_m, srs), *(getattr(tree, name) for name in COLUMNS)) for tree in trees],
            )


def write_geojson(path: Path, trees: Sequence[Tree], positions_deg: NDArray[np.float64]) -> None:
    """Write points with all columns of ``trees.csv``; ``positions_deg`` (N, 2) are longitude and latitude in WGS84."""
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [round(v, _DEGREE_DIGITS) for v in position]},
            "properties": {name: getattr(tree, name) for name in COLUMNS},
        }
        for tree, position in zip(trees, positions_deg.tolist(), strict=True)
    ]
    write_text(path, json.dumps({"type": "FeatureCollection", "features": features}, indent=1, ensure_ascii=False))


def _point(x_m: float, y_m: float, srs: int) -> bytes:
    """GeoPackage geometry: header without envelope, little endian, then WKB."""
    return b"GP" + struct.pack("<BBi", 0, 1, srs) + struct.pack("<BIdd", 1, 1, x_m, y_m)


def _sql_kind(annotation: str) -> str:
    if "bool" in annotation:
        return "BOOLEAN"
    if "int" in annotation:
        return "INTEGER"
    return "TEXT" if "str" in annotation or "Notice" in annotation else "DOUBLE"
