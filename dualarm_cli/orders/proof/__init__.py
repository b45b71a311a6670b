"""How good an order can be: bounds on all orders, and orders that are nearly as good."""
