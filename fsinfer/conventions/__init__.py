"""What forest mensuration has agreed on and several packages share; light to import."""
