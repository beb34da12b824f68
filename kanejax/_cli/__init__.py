"""Parts of the command line `kanejax`."""
