"""The page of `galen-hw dashboard`: the robot live in a browser, with the buttons that its operators need."""
