class Attentive: pass
