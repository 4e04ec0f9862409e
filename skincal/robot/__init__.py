"""What a hand is: its description, kinematics, and the contact that its joints tell of."""
