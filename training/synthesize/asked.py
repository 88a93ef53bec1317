"""What the options of ``python -m training.synthesize`` ask for: photographs for textures, a phone's effects."""

from __future__ import annotations

import argparse
from pathlib import Path

from training.synthesize.cameras.phone import PHONE, PHONE_VIDEO, PhoneEffects, with_overrides


def texture_photos(args: argparse.Namespace) -> tuple[Path, ...]:
    """The photographs that ``--textures`` and ``--texture-names`` allow."""
    if args.textures is None:
        return ()
    found = sorted(p for p in args.textures.iterdir() if p.suffix in (".jpg", ".png"))
    if args.texture_names:
        wanted = set(args.texture_names.split(","))
        found = [p for p in found if p.stem in wanted]
        if len(found) != len(wanted):
            raise SystemExit(f"--texture-names: {sorted(wanted - {p.stem for p in found})} are not in {args.textures}")
    return tuple(found)


def phone_effects(args: argparse.Namespace) -> PhoneEffects | None:
    """What ``--phone``, ``--phone-video`` and ``--effect`` ask for; None where nothing is asked."""
    if not (args.phone or args.phone_video or args.effect):
        return None
    preset = PHONE if args.phone else PHONE_VIDEO if args.phone_video else PhoneEffects(distortion=args.distortion)
    return with_overrides(preset, args.effect)
