"""The paper as a program: devices train, edges join their models, the cloud joins the edges'."""
