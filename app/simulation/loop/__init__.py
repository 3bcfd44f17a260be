"""The live loop: real time, commands in, snapshots out."""
