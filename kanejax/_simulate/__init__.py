"""Simulation: the equations of motion and the kinematical equations, integrated by diffrax."""
