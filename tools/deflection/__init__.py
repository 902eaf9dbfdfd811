"""`galen-hw deflection`: models fitted, compared on sets that none of them saw, drawn and saved."""
