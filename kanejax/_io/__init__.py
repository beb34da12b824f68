"""Reading models: files and MuJoCo models in, parameters and a report of what was left out."""
