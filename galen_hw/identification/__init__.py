"""What hangs on the sensor: the report's two steps, the joint fit that is recommended instead, and how they compare."""
