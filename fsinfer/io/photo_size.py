"""How large a photograph needs to be; light to import."""

from __future__ import annotations

#: Longer side of photographs at most, pixels; larger ones are reduced to it or up to a fifth less. Source:
#: docs/trials-speed.md; a phone's 12 megapixels are then decoded at half their width, 60 of them take 180 instead of
#: 300 s, and the edges of stems are told no worse; renders only.
PHOTO_SIZE_PX = 2400
