"""The commands, a file each: a function of the same name with its EXAMPLES, or a `group` of several."""
