"""Configuration: schema, defaults, robot and tool files, systemd and udev files."""
