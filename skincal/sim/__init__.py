"""One PyBullet client: the fingers, their controller, contact and a reference skin."""
