"""What ``rig.toml`` may state beyond the thesis's own model, as its section 8.3 recommends."""
