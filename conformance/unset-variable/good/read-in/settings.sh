dataset=all
