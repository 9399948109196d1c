"""Pictures of results: ``draw_x(result, ax) -> ax``, and figures made of them."""
