"""Virtual devices: the other ends of the wires, written from the data sheets, reading one world."""
