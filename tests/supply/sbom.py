"""The list of a wheel's parts for machines: CycloneDX 1.6.

The wheel with its hash, the networks in it with theirs, and the packages that it needs, in the versions that are
installed where the list is made, with their licences and who asks for whom. The same wheel beside the same packages
gives the same file but for the time, which SOURCE_DATE_EPOCH can fix.
"""

from __future__ import annotations

import hashlib
import os
import uuid
from datetime import UTC, datetime
from pathlib import Path

from cyclonedx.model import HashAlgorithm, HashType
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.model.license import DisjunctiveLicense, LicenseExpression
from cyclonedx.output.json import JsonV1Dot6
from license_expression import combine_expressions
from packageurl import PackageURL

from tests.supply.installed import Installed, closure
from tests.supply.licences import is_allowed, package
from tests.supply.wheel import Wheel


def bill_of_materials(wheel: Wheel, packages: Installed) -> Bom:
    """The parts of a wheel, and what it needs of what is installed.

    Raises
    ------
    MissingPackage
        Something that the wheel needs is not installed.
    """
    name, version = str(wheel.metadata["Name"]), str(wheel.metadata["Version"])
    digest = hashlib.sha256(wheel.path.read_bytes()).hexdigest()
    root = Component(
        name=name,
        version=version,
        type=ComponentType.APPLICATION,
        bom_ref=f"{name}@{version}",
        purl=PackageURL("pypi", None, name, version),
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=digest)],
        licenses=_licenses((str(wheel.metadata["License-Expression"]),)),
    )
    models = [
        Component(
            name=file,
            version=version,
            type=ComponentType.MACHINE_LEARNING_MODEL,
            bom_ref=f"{name}@{version}/{file}",
            hashes=[HashType(alg=HashAlgorithm.SHA_256, content=hashlib.sha256(content).hexdigest())],
            licenses=root.licenses,
        )
        for file, content in sorted(wheel.models.items())
    ]
    needs = closure(packages, name)
    (own, below), *others = needs.items()
    libraries = {other: _library(packages, other) for other, _ in sorted(others)}
    bom = Bom(serial_number=uuid.uuid5(uuid.NAMESPACE_OID, digest), components=[*models, *libraries.values()])
    bom.metadata.component = root
    bom.metadata.timestamp = datetime.fromtimestamp(
        int(os.environ.get("SOURCE_DATE_EPOCH", datetime.now(UTC).timestamp())), UTC
    )
    bom.register_dependency(root, [*models, *(libraries[other] for other in below)])
    for other, asked in others:
        bom.register_dependency(libraries[other], [libraries[one] for one in asked if one != own])
    return bom


def write_sbom(wheel: Wheel, packages: Installed, path: Path) -> None:
    """Write the list as JSON."""
    bom = bill_of_materials(wheel, packages)
    path.write_text(JsonV1Dot6(bom).output_as_string(indent=1) + "\n", encoding="utf-8")


def _library(packages: Installed, name: str) -> Component:
    told = package(packages[name])  # type: ignore[index]
    return Component(
        name=told.name,
        version=told.version,
        type=ComponentType.LIBRARY,
        bom_ref=f"{told.name}@{told.version}",
        purl=PackageURL("pypi", None, told.name, told.version),
        licenses=_licenses(told.licences),
    )


def _licenses(licences: tuple[str, ...]) -> list[DisjunctiveLicense | LicenseExpression]:
    """Licences as CycloneDX has them: one expression, or names."""
    if not licences:
        return []
    if all(is_allowed(licence) for licence in licences):
        return [LicenseExpression(str(combine_expressions(licences)))]
    return [DisjunctiveLicense(name=licence) for licence in licences]
