"""Rational polynomial coefficients: fitted, refined, written."""
