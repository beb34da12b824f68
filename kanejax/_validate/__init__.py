"""What `kanejax.validate` is made of: random states, the peers that are compared with, and the report."""
