"""The rim of a disk as a heat conductor: the fast modal engine, the reference scheme it is tested against, closed forms."""
