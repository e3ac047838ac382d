"""Published ways of joining models that ours is compared with, written from their descriptions onto our rasterizer and trainer."""
