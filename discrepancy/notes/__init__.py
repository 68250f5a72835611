"""What a recording says of the plant beside friction: a load, a zero, an area or a range, a tone of a sensor."""
