"""Device drivers: pure state machines from wire to message, and the transports that feed them."""
