"""The rim of a disk as a heat conductor: a fast modal engine, the reference scheme, closed forms."""
