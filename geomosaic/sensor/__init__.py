"""The contract of sensor models, their plugins, and what is solved for any of them."""
