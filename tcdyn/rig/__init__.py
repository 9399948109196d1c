"""The rig: ``rig.toml``, disks, contact, columns of logs, checks, records, and static lines."""
