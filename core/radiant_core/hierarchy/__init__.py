"""The paper's system as a program: a device trains, an edge joins its devices' models, the cloud joins its edges'."""
