"""An episode to look at: frames and curves on a page, on a sheet, or in Rerun's viewer."""
