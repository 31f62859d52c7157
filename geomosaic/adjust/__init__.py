"""Adjustments of one image and of many, from control and common points, whatever the sensor."""
