# git marks a conflict by <<<<<<< and >>>>>>> lines
echo "======="
