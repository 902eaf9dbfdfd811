"""What must hold before anything is fitted."""
