"""The rendered forest: terrain, stems, foliage, light, materials."""
