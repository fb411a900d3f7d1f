pip_once() {
    pip install "$1"
}
python -c "import sys; print(sys.version)"
cd "${ADAPTER_DIR}"
