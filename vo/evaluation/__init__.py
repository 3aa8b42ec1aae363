"""How far an estimated trajectory is from the true one."""
